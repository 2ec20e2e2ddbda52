/* Triangles in a depth buffer: the body of `rasterize` in the Python module `raster`, which says
   what pixels and depths are. Every number is computed as there, so that pictures are the same. */

#include "functions.h"

typedef struct {
    Py_ssize_t triangles, size;
    const double *corner;
    int64_t *face;
    double *depth;
} Buffer;

/* Depth over a triangle: that at its first corner, and the slopes along x and y. */
typedef struct {
    double depth, x, y;
} Plane;

static const double EDGE_ON = 1e-9;

INLINE double clip_to_pixels(double end, double size)
{
    double pixel = ceil(end - 0.5);
    return pixel > 0 ? (pixel < size ? pixel : size) : 0;
}

INLINE Plane find_plane(const double *a)
{
    double one[3], two[3], normal[3];
    for (int k = 0; k < 3; k++)
        one[k] = a[3 + k] - a[k], two[k] = a[6 + k] - a[k];
    for (int k = 0; k < 3; k++) {
        int p = (k + 1) % 3, q = (k + 2) % 3;
        normal[k] = one[p] * two[q] - one[q] * two[p];
    }
    double size = fabs(normal[0]) + fabs(normal[1]) + fabs(normal[2]);
    if (fabs(normal[2]) <= EDGE_ON * size)
        return (Plane){(a[2] + a[5] + a[8]) / 3, 0, 0};
    return (Plane){a[2], -normal[0] / normal[2], -normal[1] / normal[2]};
}

INLINE void exchange_by_height(double *x, double *y, int one, int other)
{
    if (y[one] > y[other]) {
        double value = x[one];
        x[one] = x[other], x[other] = value;
        value = y[one];
        y[one] = y[other], y[other] = value;
    }
}

/* Draws each row from the tallest edge of the triangle to one of the two others. Of triangles that
   are equally near, the last is kept. */
static void draw_triangle(const Buffer *b, Py_ssize_t i)
{
    const double *corner = b->corner + 9 * i, size = (double)b->size;
    double x[3], y[3], slope[3], low_x = HUGE_VAL, high_x = -HUGE_VAL;
    const int start[3] = {0, 1, 0}, end[3] = {1, 2, 2};
    for (int k = 0; k < 9; k++)
        if (!isfinite(corner[k]))
            return;
    for (int k = 0; k < 3; k++) {
        x[k] = corner[3 * k], y[k] = corner[3 * k + 1];
        low_x = x[k] < low_x ? x[k] : low_x, high_x = x[k] > high_x ? x[k] : high_x;
    }
    /* Always from the lower end, so that both neighbours of an edge get the same crossing. */
    exchange_by_height(x, y, 0, 1), exchange_by_height(x, y, 1, 2), exchange_by_height(x, y, 0, 1);
    if (!(clip_to_pixels(high_x, size) > clip_to_pixels(low_x, size)))
        return;
    for (int k = 0; k < 3; k++) {
        double rise = y[end[k]] - y[start[k]];
        slope[k] = (x[end[k]] - x[start[k]]) / (rise > 0 ? rise : 1);
    }
    const Plane plane = find_plane(corner);
    const Py_ssize_t last = (Py_ssize_t)clip_to_pixels(y[2], size);
    for (Py_ssize_t row = (Py_ssize_t)clip_to_pixels(y[0], size); row < last; row++) {
        const double at = (double)row + 0.5;
        const int k = at >= y[1];
        double one = x[start[k]] + slope[k] * (at - y[start[k]]), other = x[0] + slope[2] * (at - y[0]);
        double left = clip_to_pixels(one < other ? one : other, size);
        double right = clip_to_pixels(one < other ? other : one, size);
        double first = plane.depth + plane.x * (left + 0.5 - corner[0]) + plane.y * (at - corner[1]);
        Py_ssize_t pixel = row * b->size + (Py_ssize_t)left;
        for (Py_ssize_t step = 0; step < (Py_ssize_t)(right - left); step++) {
            double depth = first + plane.x * (double)step;
            if (depth <= b->depth[pixel + step]) {
                b->depth[pixel + step] = depth;
                b->face[pixel + step] = i;
            }
        }
    }
}

PyObject *draw_triangles(PyObject *module, PyObject *arguments)
{
    Arrays arrays = {.count = 0};
    Buffer b = {.triangles = 0};
    PyObject *corner, *face, *depth;
    Py_ssize_t corners[3] = {ANY, 3, 3}, square[2] = {ANY, ANY};
    (void)module;
    if (!PyArg_ParseTuple(arguments, "OOO", &corner, &face, &depth))
        return NULL;
    int is_valid = (b.corner = take_array(&arrays, corner, "corners", 'd', READ, 3, corners)) &&
                   (b.face = take_array(&arrays, face, "face", 'q', WRITE, 2, square));
    if (is_valid && square[0] != square[1]) {
        PyErr_SetString(PyExc_ValueError, "face: expected a square");
        is_valid = 0;
    }
    is_valid = is_valid && (b.depth = take_array(&arrays, depth, "depth", 'd', WRITE, 2, square));
    b.triangles = corners[0], b.size = square[0];
    if (is_valid) {
        Py_BEGIN_ALLOW_THREADS
        for (Py_ssize_t i = 0; i < b.triangles; i++)
            draw_triangle(&b, i);
        Py_END_ALLOW_THREADS
    }
    release_arrays(&arrays);
    return is_valid ? Py_NewRef(Py_None) : NULL;
}
