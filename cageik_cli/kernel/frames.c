/* Frames of a clip: aligned with the rest pose, and measured against their reconstructions.

   The functions of `columns`, `alignment` and `metrics` in Python are the reference. Sums are
   taken in lanes that are added at the end, which rounds less than one sum does. */

#include "kernel.h"

enum { LANES = 8, BLOCK = 64 };

typedef double Lanes[LANES];

INLINE double add_lanes(const double *lane)
{
    return ((lane[0] + lane[4]) + (lane[2] + lane[6])) + ((lane[1] + lane[5]) + (lane[3] + lane[7]));
}

/* The weighted mean of `count` points. */
INLINE void find_centre(const double *point, const double *weight, Py_ssize_t count, double *centre)
{
    Lanes x = {0}, y = {0}, z = {0}, total = {0};
    Py_ssize_t whole = count - count % LANES;
    for (Py_ssize_t j = 0; j < whole; j += LANES) {
        for (int l = 0; l < LANES; l++) {
            const double *v = point + 3 * (j + l);
            const double w = weight[j + l];
            x[l] += w * v[0], y[l] += w * v[1], z[l] += w * v[2], total[l] += w;
        }
    }
    for (Py_ssize_t j = whole; j < count; j++) {
        const double *v = point + 3 * j;
        const double w = weight[j];
        x[0] += w * v[0], y[0] += w * v[1], z[0] += w * v[2], total[0] += w;
    }
    double sum = add_lanes(total);
    centre[0] = add_lanes(x) / sum, centre[1] = add_lanes(y) / sum, centre[2] = add_lanes(z) / sum;
}

INLINE void add_covariance(Lanes *sum, int l, const double *rest, double weight, const double *v,
                           const double *centre)
{
    double x = v[0] - centre[0], y = v[1] - centre[1], z = v[2] - centre[2];
    for (int a = 0; a < 3; a++) {
        double r = weight * rest[a];
        sum[3 * a][l] += r * x, sum[3 * a + 1][l] += r * y, sum[3 * a + 2][l] += r * z;
    }
}

/* Sum_j weight_j rest_j (v_j - centre)^T, row by row. */
INLINE void find_covariance(const double *point, const double *rest, const double *weight,
                            Py_ssize_t count, const double *centre, double *covariance)
{
    Lanes sum[9];
    for (int k = 0; k < 9; k++)
        for (int l = 0; l < LANES; l++)
            sum[k][l] = 0;
    Py_ssize_t whole = count - count % LANES;
    for (Py_ssize_t j = 0; j < whole; j += LANES)
        for (int l = 0; l < LANES; l++)
            add_covariance(sum, l, rest + 3 * (j + l), weight[j + l], point + 3 * (j + l), centre);
    for (Py_ssize_t j = whole; j < count; j++)
        add_covariance(sum, 0, rest + 3 * j, weight[j], point + 3 * j, centre);
    for (int k = 0; k < 9; k++)
        covariance[k] = add_lanes(sum[k]);
}

FOR_EACH_PROCESSOR
static void fill_moments(const double *frame, const double *weight, const double *rest,
                         Py_ssize_t frames, Py_ssize_t count, double *centre, double *covariance)
{
    for (Py_ssize_t k = 0; k < frames; k++, frame += 3 * count) {
        find_centre(frame, weight, count, centre + 3 * k);
        find_covariance(frame, rest, weight, count, centre + 3 * k, covariance + 9 * k);
    }
}

/* R (v - centre) - rest, frame by frame into columns; in blocks of vertices, whose columns stay in
   the cache. */
FOR_EACH_PROCESSOR
static void fill_columns(const double *frame, const double *centre, const double *rotation,
                         const double *rest, Py_ssize_t frames, Py_ssize_t count, double *column)
{
    for (Py_ssize_t start = 0; start < count; start += BLOCK) {
        Py_ssize_t stop = count - start < BLOCK ? count : start + BLOCK;
        for (Py_ssize_t k = 0; k < frames; k++) {
            const double *r = rotation + 9 * k, *c = centre + 3 * k;
            for (Py_ssize_t j = start; j < stop; j++) {
                const double *v = frame + 3 * (k * count + j), *at = rest + 3 * j;
                double *out = column + 3 * (j * frames + k);
                double x = v[0] - c[0], y = v[1] - c[1], z = v[2] - c[2];
                out[0] = x * r[0] + y * r[1] + z * r[2] - at[0];
                out[1] = x * r[3] + y * r[4] + z * r[5] - at[1];
                out[2] = x * r[6] + y * r[7] + z * r[8] - at[2];
            }
        }
    }
}

/* Columns plus the centres of their frames, as the first `count` of `all` points of each frame. */
FOR_EACH_PROCESSOR
static void fill_frames(const double *column, const double *centre, Py_ssize_t frames,
                        Py_ssize_t count, Py_ssize_t all, double *frame)
{
    if (frames == 0)
        return; /* of any number of points */
    for (Py_ssize_t start = 0; start < count; start += BLOCK) {
        Py_ssize_t stop = count - start < BLOCK ? count : start + BLOCK;
        for (Py_ssize_t k = 0; k < frames; k++) {
            const double *c = centre + 3 * k;
            for (Py_ssize_t j = start; j < stop; j++) {
                const double *v = column + 3 * (j * frames + k);
                double *out = frame + 3 * (k * all + j);
                out[0] = v[0] + c[0], out[1] = v[1] + c[1], out[2] = v[2] + c[2];
            }
        }
    }
}

typedef struct {
    Py_ssize_t frames, count, faces;
    const double *frame, *rebuilt;
    const uint8_t *is_data;
    const int64_t *face;
    double *square, *sum;
    int64_t *worst;
} Comparison;

/* What is summed over a frame; `sum` of the results has these, in this order. */
enum { SQUARES, LARGEST, SPREAD, VOLUME, VOLUME_REBUILT, SUMS };

typedef struct {
    Lanes square, largest, x, y, z, data;
    int64_t at[LANES];
} Errors;

INLINE void add_error(Errors *e, int l, Py_ssize_t j, const double *v, const double *rebuilt,
                      int is_data, double *square)
{
    double x = rebuilt[0] - v[0], y = rebuilt[1] - v[1], z = rebuilt[2] - v[2];
    double s = x * x + y * y + z * z, kept = is_data ? s : 0, compared = is_data ? s : -1;
    *square = s;
    e->square[l] += kept;
    e->at[l] = compared > e->largest[l] ? (int64_t)j : e->at[l];
    e->largest[l] = compared > e->largest[l] ? compared : e->largest[l];
    e->x[l] += is_data ? v[0] : 0, e->y[l] += is_data ? v[1] : 0, e->z[l] += is_data ? v[2] : 0;
    e->data[l] += is_data ? 1 : 0;
}

INLINE double measure_spread(const double *v, const uint8_t *is_data, Py_ssize_t count,
                             const double *centre)
{
    Lanes sum = {0};
    Py_ssize_t whole = count - count % LANES;
    for (Py_ssize_t j = 0; j < count; j += LANES) {
        int lanes = j < whole ? LANES : (int)(count - j);
        for (int l = 0; l < lanes; l++) {
            const double *at = v + 3 * (j + l);
            double x = at[0] - centre[0], y = at[1] - centre[1], z = at[2] - centre[2];
            sum[l] += is_data[j + l] ? x * x + y * y + z * z : 0;
        }
    }
    return add_lanes(sum);
}

/* Six times the signed volume. From a vertex, a mesh far from the origin loses no digits. */
INLINE double measure_volume(const Comparison *p, const double *v, const double *origin)
{
    Lanes sum = {0};
    for (Py_ssize_t i = 0; i < p->faces; i++) {
        const int64_t *face = p->face + 3 * i;
        const double *a = v + 3 * face[0], *b = v + 3 * face[1], *c = v + 3 * face[2];
        double bx = b[0] - origin[0], by = b[1] - origin[1], bz = b[2] - origin[2];
        double cx = c[0] - origin[0], cy = c[1] - origin[1], cz = c[2] - origin[2];
        sum[i % LANES] += (a[0] - origin[0]) * (by * cz - bz * cy)
                          + (a[1] - origin[1]) * (bz * cx - bx * cz)
                          + (a[2] - origin[2]) * (bx * cy - by * cx);
    }
    return add_lanes(sum);
}

FOR_EACH_PROCESSOR
static void compare_frame(const Comparison *p, Py_ssize_t k)
{
    const double *v = p->frame + 3 * k * p->count, *rebuilt = p->rebuilt + 3 * k * p->count;
    double *square = p->square + k * p->count, *sum = p->sum + SUMS * k;
    Errors e = {.at = {0}};
    Py_ssize_t whole = p->count - p->count % LANES;
    for (int l = 0; l < LANES; l++)
        e.largest[l] = -1;
    for (Py_ssize_t j = 0; j < whole; j += LANES)
        for (int l = 0; l < LANES; l++)
            add_error(&e, l, j + l, v + 3 * (j + l), rebuilt + 3 * (j + l), p->is_data[j + l],
                      square + j + l);
    for (Py_ssize_t j = whole; j < p->count; j++)
        add_error(&e, (int)(j - whole), j, v + 3 * j, rebuilt + 3 * j, p->is_data[j], square + j);
    int best = 0;
    for (int l = 1; l < LANES; l++)
        if (e.largest[l] > e.largest[best] ||
            (e.largest[l] == e.largest[best] && e.at[l] < e.at[best]))
            best = l;
    double data = add_lanes(e.data);
    double centre[3] = {add_lanes(e.x) / data, add_lanes(e.y) / data, add_lanes(e.z) / data};
    p->worst[k] = e.at[best];
    sum[SQUARES] = add_lanes(e.square);
    sum[LARGEST] = e.largest[best];
    sum[SPREAD] = measure_spread(v, p->is_data, p->count, centre);
    sum[VOLUME] = sum[VOLUME_REBUILT] = 0;
    if (p->faces) {
        sum[VOLUME] = measure_volume(p, v, v + 3 * p->face[0]);
        sum[VOLUME_REBUILT] = measure_volume(p, rebuilt, rebuilt + 3 * p->face[0]);
    }
}

PyObject *sum_moments(PyObject *module, PyObject *arguments)
{
    Arrays arrays = {.count = 0};
    PyObject *objects[5];
    double *data[5];
    (void)module;
    if (!PyArg_ParseTuple(arguments, "OOOOO", &objects[0], &objects[1], &objects[2], &objects[3],
                          &objects[4]))
        return NULL;
    Py_ssize_t shape[3] = {ANY, ANY, 3};
    int is_valid = (data[0] = take_array(&arrays, objects[0], "frames", 'd', READ, 3, shape)) != NULL;
    Py_ssize_t k = shape[0], m = shape[1];
    Py_ssize_t rest[2] = {m, 3}, centres[2] = {k, 3}, covariances[3] = {k, 3, 3};
    is_valid = is_valid &&
               (data[1] = take_array(&arrays, objects[1], "weights", 'd', READ, 1, &m)) &&
               (data[2] = take_array(&arrays, objects[2], "rest", 'd', READ, 2, rest)) &&
               (data[3] = take_array(&arrays, objects[3], "centres", 'd', WRITE, 2, centres)) &&
               (data[4] = take_array(&arrays, objects[4], "covariances", 'd', WRITE, 3, covariances));
    if (is_valid) {
        Py_BEGIN_ALLOW_THREADS
        fill_moments(data[0], data[1], data[2], k, m, data[3], data[4]);
        Py_END_ALLOW_THREADS
    }
    release_arrays(&arrays);
    return is_valid ? Py_NewRef(Py_None) : NULL;
}

PyObject *align_frames(PyObject *module, PyObject *arguments)
{
    Arrays arrays = {.count = 0};
    PyObject *objects[5];
    double *data[5];
    (void)module;
    if (!PyArg_ParseTuple(arguments, "OOOOO", &objects[0], &objects[1], &objects[2], &objects[3],
                          &objects[4]))
        return NULL;
    Py_ssize_t shape[3] = {ANY, ANY, 3};
    int is_valid = (data[0] = take_array(&arrays, objects[0], "frames", 'd', READ, 3, shape)) != NULL;
    Py_ssize_t k = shape[0], m = shape[1];
    Py_ssize_t centres[2] = {k, 3}, rotations[3] = {k, 3, 3}, rest[2] = {m, 3}, columns[2] = {m, 3 * k};
    is_valid = is_valid &&
               (data[1] = take_array(&arrays, objects[1], "centres", 'd', READ, 2, centres)) &&
               (data[2] = take_array(&arrays, objects[2], "rotations", 'd', READ, 3, rotations)) &&
               (data[3] = take_array(&arrays, objects[3], "rest", 'd', READ, 2, rest)) &&
               (data[4] = take_array(&arrays, objects[4], "columns", 'd', WRITE, 2, columns));
    if (is_valid) {
        Py_BEGIN_ALLOW_THREADS
        fill_columns(data[0], data[1], data[2], data[3], k, m, data[4]);
        Py_END_ALLOW_THREADS
    }
    release_arrays(&arrays);
    return is_valid ? Py_NewRef(Py_None) : NULL;
}

PyObject *place_columns(PyObject *module, PyObject *arguments)
{
    Arrays arrays = {.count = 0};
    PyObject *column, *centre, *frame;
    Py_ssize_t first;
    double *data[3];
    (void)module;
    if (!PyArg_ParseTuple(arguments, "OOOn", &column, &centre, &frame, &first))
        return NULL;
    Py_ssize_t shape[3] = {ANY, ANY, 3};
    int is_valid = (data[2] = take_array(&arrays, frame, "frames", 'd', WRITE, 3, shape)) != NULL;
    Py_ssize_t k = shape[0], m = shape[1], columns[2] = {ANY, 3 * k}, centres[2] = {k, 3};
    is_valid = is_valid &&
               (data[0] = take_array(&arrays, column, "columns", 'd', READ, 2, columns)) &&
               (data[1] = take_array(&arrays, centre, "centres", 'd', READ, 2, centres));
    if (is_valid && (first < 0 || first > m - columns[0])) {
        PyErr_Format(PyExc_ValueError, "columns: %zd points from %zd on, expected at most %zd",
                     columns[0], first, m);
        is_valid = 0;
    }
    if (is_valid) {
        Py_BEGIN_ALLOW_THREADS
        fill_frames(data[0], data[1], k, columns[0], m, data[2] + 3 * first);
        Py_END_ALLOW_THREADS
    }
    release_arrays(&arrays);
    return is_valid ? Py_NewRef(Py_None) : NULL;
}

PyObject *compare_frames(PyObject *module, PyObject *arguments)
{
    Arrays arrays = {.count = 0};
    Comparison p;
    PyObject *frame, *rebuilt, *is_data, *face, *square, *sum, *worst;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "OOOOOOO", &frame, &rebuilt, &is_data, &face, &square, &sum,
                          &worst))
        return NULL;
    Py_ssize_t shape[3] = {ANY, ANY, 3}, faces[2] = {ANY, 3};
    int is_valid = (p.frame = take_array(&arrays, frame, "frames", 'd', READ, 3, shape)) != NULL;
    p.frames = shape[0], p.count = shape[1];
    Py_ssize_t squares[2] = {p.frames, p.count}, sums[2] = {p.frames, SUMS};
    is_valid = is_valid &&
               (p.rebuilt = take_array(&arrays, rebuilt, "reconstructions", 'd', READ, 3, shape)) &&
               (p.is_data = take_array(&arrays, is_data, "data", 'B', READ, 1, &p.count)) &&
               (p.face = take_array(&arrays, face, "faces", 'q', READ, 2, faces)) &&
               (p.square = take_array(&arrays, square, "squares", 'd', WRITE, 2, squares)) &&
               (p.sum = take_array(&arrays, sum, "sums", 'd', WRITE, 2, sums)) &&
               (p.worst = take_array(&arrays, worst, "worst", 'q', WRITE, 1, &p.frames)) &&
               check_indices(p.face, 3 * faces[0], p.count, "faces");
    p.faces = faces[0];
    if (is_valid) {
        Py_BEGIN_ALLOW_THREADS
        for (Py_ssize_t k = 0; k < p.frames; k++)
            compare_frame(&p, k);
        Py_END_ALLOW_THREADS
    }
    release_arrays(&arrays);
    return is_valid ? Py_NewRef(Py_None) : NULL;
}
