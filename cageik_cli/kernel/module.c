/* The compiled core: the module, and the arrays that its functions take. */

#include "kernel.h"

static const char *describe(char type)
{
    return type == 'd' ? "float64" : type == 'q' ? "int64" : type == 'i' ? "int32" : "uint8";
}

static int has_type(const Py_buffer *buffer, char type)
{
    const char *format = buffer->format ? buffer->format : "B";
    if (type == 'd')
        return buffer->itemsize == 8 && format[0] == 'd' && !format[1];
    if (type == 'B')
        return buffer->itemsize == 1 && format[0] == 'B' && !format[1];
    /* A C long has 4 or 8 bytes. */
    return buffer->itemsize == (type == 'q' ? 8 : 4) &&
           (format[0] == 'q' || format[0] == 'l' || format[0] == 'i') && !format[1];
}

void *take_array(Arrays *arrays, PyObject *object, const char *name, char type, int access,
                 int dimensions, Py_ssize_t *lengths)
{
    if (arrays->count == MAX_BUFFERS) {
        PyErr_SetString(PyExc_SystemError, "too many arrays");
        return NULL;
    }
    Py_buffer *buffer = &arrays->taken[arrays->count];
    int flags = PyBUF_C_CONTIGUOUS | PyBUF_FORMAT | (access == WRITE ? PyBUF_WRITABLE : 0);
    if (PyObject_GetBuffer(object, buffer, flags) < 0) {
        if (PyErr_ExceptionMatches(PyExc_BufferError) || PyErr_ExceptionMatches(PyExc_TypeError) ||
            PyErr_ExceptionMatches(PyExc_ValueError)) {
            PyErr_Clear();
            PyErr_Format(PyExc_TypeError, "%s: expected a C-contiguous array%s", name,
                         access == WRITE ? " that can be written" : "");
        }
        return NULL;
    }
    arrays->count++;
    if (!has_type(buffer, type) || buffer->ndim != dimensions) {
        PyErr_Format(PyExc_TypeError, "%s: expected an array of %s with %d dimensions", name,
                     describe(type), dimensions);
        return NULL;
    }
    if ((uintptr_t)buffer->buf % (size_t)buffer->itemsize != 0) {
        PyErr_Format(PyExc_TypeError, "%s: expected an array that is aligned in memory", name);
        return NULL;
    }
    for (int k = 0; k < dimensions; k++) {
        if (lengths[k] == ANY)
            lengths[k] = buffer->shape[k];
        if (lengths[k] != buffer->shape[k]) {
            PyErr_Format(PyExc_ValueError, "%s: length %zd along axis %d, expected %zd", name,
                         buffer->shape[k], k, lengths[k]);
            return NULL;
        }
    }
    return buffer->buf;
}

void release_arrays(Arrays *arrays)
{
    for (int k = 0; k < arrays->count; k++)
        PyBuffer_Release(&arrays->taken[k]);
    arrays->count = 0;
}

int check_indices(const int64_t *numbers, Py_ssize_t count, Py_ssize_t limit, const char *name)
{
    for (Py_ssize_t k = 0; k < count; k++) {
        if (numbers[k] < 0 || numbers[k] >= limit) {
            PyErr_Format(PyExc_ValueError, "%s: number %lld, expected 0 to %zd", name,
                         (long long)numbers[k], limit - 1);
            return 0;
        }
    }
    return 1;
}

static PyMethodDef methods[] = {
    {"compute_potentials", compute_potentials, METH_VARARGS,
     "compute_potentials(limits, panels, hats, terms, points, is_inside, results)"},
    {"compute_functions", compute_functions, METH_VARARGS,
     "compute_functions(y, x, log, arctan2): the logarithm of x and the angle of (x, y)"},
    {"parse_words", parse_words, METH_VARARGS,
     "parse_words(text, bounds, is_long, has_integers, numbers): whether all words are numbers"},
    {"parse_positions", parse_positions, METH_VARARGS,
     "parse_positions(text, length, positions): whether the text is vertices in plain OBJ lines"},
    {"sum_moments", sum_moments, METH_VARARGS,
     "sum_moments(frames, weights, rest, centres, covariances)"},
    {"align_frames", align_frames, METH_VARARGS,
     "align_frames(frames, centres, rotations, rest, columns)"},
    {"place_columns", place_columns, METH_VARARGS, "place_columns(columns, centres, frames, first)"},
    {"compare_frames", compare_frames, METH_VARARGS,
     "compare_frames(frames, reconstructions, is_data, faces, squares, sums, worst)"},
    {"closest_points", closest_points, METH_VARARGS,
     "closest_points(points, vertices, faces, boxes, squares, nearest, positions)"},
    {"winding_numbers", winding_numbers, METH_VARARGS,
     "winding_numbers(points, vertices, faces, winding)"},
    {"draw_triangles", draw_triangles, METH_VARARGS, "draw_triangles(corners, face, depth)"},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT,
    .m_name = "_kernel",
    .m_doc = "The compiled core of cageik; `cageik_cli.util.compiled` imports it.",
    .m_size = 0,
    .m_methods = methods,
};

PyMODINIT_FUNC PyInit__kernel(void)
{
    return PyModuleDef_Init(&definition);
}
