/* What the parts of the compiled core share. */

#ifndef CAGEIK_KERNEL_H
#define CAGEIK_KERNEL_H

#define PY_SSIZE_T_CLEAN
#define Py_LIMITED_API 0x030B0000
#include <Python.h>

#include <stdint.h>

/* Loops over lanes are compiled for several processors; the loader picks the widest that works.
   Nothing else differs: no multiply and add are merged, so that each gives the same bits. */
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && defined(__GLIBC__) && \
    !defined(CAGEIK_ONE_TARGET)
#define FOR_EACH_PROCESSOR __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define FOR_EACH_PROCESSOR
#endif

#if defined(__GNUC__)
#define INLINE static inline __attribute__((always_inline))
#else
#define INLINE static inline
#endif

enum { MAX_BUFFERS = 32, ANY = -1 };

/* The arrays of a call; all are released at its end. */
typedef struct {
    Py_buffer taken[MAX_BUFFERS];
    int count;
} Arrays;

enum { READ = 0, WRITE = 1 };

/* Returns the data of a C-contiguous array, or NULL with an exception set. `type` is 'd' for
   float64, 'q' for int64, 'i' for int32, 'B' for uint8. A length of ANY is not checked; `lengths`
   gets those of the array. */
void *take_array(Arrays *arrays, PyObject *object, const char *name, char type, int access,
                 int dimensions, Py_ssize_t *lengths);
void release_arrays(Arrays *arrays);

/* Sets an exception and returns 0 unless all numbers are from 0 to below `limit`. */
int check_indices(const int64_t *numbers, Py_ssize_t count, Py_ssize_t limit, const char *name);

PyObject *compute_potentials(PyObject *module, PyObject *arguments);
PyObject *compute_functions(PyObject *module, PyObject *arguments);
PyObject *parse_words(PyObject *module, PyObject *arguments);
PyObject *parse_positions(PyObject *module, PyObject *arguments);
PyObject *sum_moments(PyObject *module, PyObject *arguments);
PyObject *align_frames(PyObject *module, PyObject *arguments);
PyObject *place_columns(PyObject *module, PyObject *arguments);
PyObject *compare_frames(PyObject *module, PyObject *arguments);
PyObject *closest_points(PyObject *module, PyObject *arguments);
PyObject *winding_numbers(PyObject *module, PyObject *arguments);
PyObject *draw_triangles(PyObject *module, PyObject *arguments);

#endif
