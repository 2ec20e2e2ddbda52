/* Points against the triangles of a surface: the closest point, and the winding number. */

#include "functions.h"

enum { LANES = 32, FACES_PER_BOX = 8 };

/* The squared sine of a triangle's first corner up to which it is thin. */
static const double THIN = 1e-3;

typedef double Row[LANES];

typedef struct {
    Py_ssize_t points, vertices, faces, boxes;
    const double *point, *vertex, *box;
    const int64_t *face, *name;
    double *square, *position, *winding;
    int64_t *nearest;
} Surface;

INLINE int take_points(const Surface *s, Py_ssize_t start, Row *at)
{
    int count = s->points - start < LANES ? (int)(s->points - start) : LANES;
    for (int j = 0; j < LANES; j++)
        for (int axis = 0; axis < 3; axis++)
            at[axis][j] = s->point[3 * (start + (j < count ? j : count - 1)) + axis];
    return count;
}

INLINE double dot(const double *a, const double *b)
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

INLINE void subtract(const double *a, const double *b, double *out)
{
    for (int axis = 0; axis < 3; axis++)
        out[axis] = a[axis] - b[axis];
}

INLINE void cross(const double *a, const double *b, double *out)
{
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

/* Keeps the closest point of the segment from `a` along `side`, for each lane. */
INLINE void meet_side(Row *at, const double *a, const double *side, Row *foot, double *least)
{
    const double length = dot(side, side), share = length > 0 ? 1 / length : 0;
    for (int j = 0; j < LANES; j++) {
        double x = at[0][j] - a[0], y = at[1][j] - a[1], z = at[2][j] - a[2];
        double t = (x * side[0] + y * side[1] + z * side[2]) * share;
        t = t > 0 ? t : 0;
        t = t < 1 ? t : 1;
        double fx = a[0] + t * side[0], fy = a[1] + t * side[1], fz = a[2] + t * side[2];
        double dx = at[0][j] - fx, dy = at[1][j] - fy, dz = at[2][j] - fz;
        double square = dx * dx + dy * dy + dz * dz;
        int is_nearer = square < least[j];
        foot[0][j] = is_nearer ? fx : foot[0][j];
        foot[1][j] = is_nearer ? fy : foot[1][j];
        foot[2][j] = is_nearer ? fz : foot[2][j];
        least[j] = is_nearer ? square : least[j];
    }
}

/* Keeps the foot on the plane where it is in the triangle; then no other point is closer. */
INLINE void meet_plane(Row *at, const double *a, const double *ab, const double *ac,
                       const double *normal, Row *foot, double *least)
{
    double u[3], v[3];
    const double size = dot(normal, normal), share = size > 0 ? 1 / size : 0;
    cross(ac, normal, u), cross(normal, ab, v);
    for (int j = 0; j < LANES; j++) {
        double x = at[0][j] - a[0], y = at[1][j] - a[1], z = at[2][j] - a[2];
        double b = (x * u[0] + y * u[1] + z * u[2]) * share;
        double c = (x * v[0] + y * v[1] + z * v[2]) * share;
        double h = (x * normal[0] + y * normal[1] + z * normal[2]) * share;
        int is_inside = (size > 0) & (b >= 0) & (c >= 0) & (b + c <= 1);
        foot[0][j] = is_inside ? at[0][j] - h * normal[0] : foot[0][j];
        foot[1][j] = is_inside ? at[1][j] - h * normal[1] : foot[1][j];
        foot[2][j] = is_inside ? at[2][j] - h * normal[2] : foot[2][j];
        least[j] = is_inside ? h * h * size : least[j];
    }
}

/* The same for a thin triangle, whose normal is little but rounding: by the height over its longest
   side, from `a` to `b`. The foot is always a point of the triangle; it is kept where it is closer
   than those of the sides. */
static void meet_thin_plane(Row *at, const double *a, const double *b, const double *c, Row *foot,
                            double *least)
{
    double side[3], across[3], height[3];
    subtract(b, a, side), subtract(c, a, across);
    const double length = dot(side, side);
    if (!(length > 0))
        return;
    const double middle = dot(across, side) / length;
    for (int axis = 0; axis < 3; axis++)
        height[axis] = across[axis] - middle * side[axis];
    const double size = dot(height, height);
    if (!(size > 0))
        return;
    for (int j = 0; j < LANES; j++) {
        double x[3] = {at[0][j] - a[0], at[1][j] - a[1], at[2][j] - a[2]}, d[3], f[3];
        const double share = dot(x, side) / length;
        for (int axis = 0; axis < 3; axis++)
            d[axis] = x[axis] - share * side[axis];
        const double third = dot(d, height) / size, second = share - third * middle;
        if (!(third >= 0 && second >= 0 && second + third <= 1))
            continue;
        for (int axis = 0; axis < 3; axis++) {
            f[axis] = a[axis] + (second * side[axis] + third * across[axis]);
            d[axis] = at[axis][j] - f[axis];
        }
        if (dot(d, d) < least[j]) {
            least[j] = dot(d, d);
            for (int axis = 0; axis < 3; axis++)
                foot[axis][j] = f[axis];
        }
    }
}

/* The closest points so far, of each lane: `name` is the least among faces that are equally close. */
typedef struct {
    Row square, at[3], bound;
    int64_t name[LANES];
} Closest;

INLINE void meet_face(const Surface *s, Py_ssize_t i, Row *at, Closest *closest)
{
    const int64_t *face = s->face + 3 * i, name = s->name[i];
    const double *a = s->vertex + 3 * face[0], *b = s->vertex + 3 * face[1];
    const double *c = s->vertex + 3 * face[2];
    double ab[3], bc[3], ca[3], ac[3], normal[3];
    Row foot[3], least;
    subtract(b, a, ab), subtract(c, b, bc), subtract(a, c, ca), subtract(c, a, ac);
    cross(ab, ac, normal);
    const double one = dot(ab, ab), two = dot(bc, bc), three = dot(ca, ca);
    for (int j = 0; j < LANES; j++)
        least[j] = HUGE_VAL;
    meet_side(at, a, ab, foot, least);
    meet_side(at, b, bc, foot, least);
    meet_side(at, c, ca, foot, least);
    if (dot(normal, normal) > THIN * (one * three))
        meet_plane(at, a, ab, ac, normal, foot, least);
    else if (one >= two && one >= three)
        meet_thin_plane(at, a, b, c, foot, least);
    else if (two >= three)
        meet_thin_plane(at, b, c, a, foot, least);
    else
        meet_thin_plane(at, c, a, b, foot, least);
    for (int j = 0; j < LANES; j++) {
        int is_equal = (least[j] == closest->square[j]) & (name < closest->name[j]);
        int is_nearer = (least[j] < closest->square[j]) | is_equal;
        closest->name[j] = is_nearer ? name : closest->name[j];
        for (int axis = 0; axis < 3; axis++)
            closest->at[axis][j] = is_nearer ? foot[axis][j] : closest->at[axis][j];
        closest->square[j] = is_nearer ? least[j] : closest->square[j];
    }
}

/* Bounds the squared distances from above, by a vertex of each box. */
INLINE void bound_squares(const Surface *s, Row *at, double *bound)
{
    for (int j = 0; j < LANES; j++)
        bound[j] = HUGE_VAL;
    for (Py_ssize_t k = 0; k < s->boxes; k++) {
        const double *vertex = s->vertex + 3 * s->face[3 * k * FACES_PER_BOX];
        for (int j = 0; j < LANES; j++) {
            double x = at[0][j] - vertex[0], y = at[1][j] - vertex[1], z = at[2][j] - vertex[2];
            double square = x * x + y * y + z * z;
            bound[j] = square < bound[j] ? square : bound[j];
        }
    }
}

/* Returns whether the box may hold a point as close as those that are known, of any lane. The
   slack is more than what rounding does to distances. */
INLINE int is_within_bounds(const double *box, Row *at, const double *bound)
{
    int is_within = 0;
    for (int j = 0; j < LANES; j++) {
        double square = 0;
        for (int axis = 0; axis < 3; axis++) {
            double below = box[axis] - at[axis][j], above = at[axis][j] - box[3 + axis];
            double gap = below > above ? below : above;
            gap = gap > 0 ? gap : 0;
            square += gap * gap;
        }
        is_within |= !(square * (1 - 1e-9) > bound[j]);
    }
    return is_within;
}

FOR_EACH_PROCESSOR
static void find_closest(const Surface *s, Py_ssize_t start)
{
    Row at[3];
    Closest closest;
    int count = take_points(s, start, at);
    for (int j = 0; j < LANES; j++) {
        closest.square[j] = HUGE_VAL, closest.name[j] = 0;
        closest.at[0][j] = closest.at[1][j] = closest.at[2][j] = 0;
    }
    bound_squares(s, at, closest.bound);
    for (Py_ssize_t k = 0; k < s->boxes; k++) {
        if (!is_within_bounds(s->box + 6 * k, at, closest.bound))
            continue;
        Py_ssize_t first = k * FACES_PER_BOX, end = first + FACES_PER_BOX;
        for (Py_ssize_t i = first; i < (end < s->faces ? end : s->faces); i++)
            meet_face(s, i, at, &closest);
        for (int j = 0; j < LANES; j++)
            closest.bound[j] = closest.square[j] < closest.bound[j] ? closest.square[j]
                                                                    : closest.bound[j];
    }
    for (int j = 0; j < count; j++) {
        s->square[start + j] = closest.square[j];
        s->nearest[start + j] = closest.name[j];
        for (int axis = 0; axis < 3; axis++)
            s->position[3 * (start + j) + axis] = closest.at[axis][j];
    }
}

/* The solid angles of the faces over 4 pi (Van Oosterom and Strackee 1983). */
FOR_EACH_PROCESSOR
static void add_angles(const Surface *s, Py_ssize_t start)
{
    Row at[3], total, a[3], b[3], c[3];
    int count = take_points(s, start, at);
    for (int j = 0; j < LANES; j++)
        total[j] = 0;
    for (Py_ssize_t i = 0; i < s->faces; i++) {
        const int64_t *face = s->face + 3 * i;
        for (int axis = 0; axis < 3; axis++) {
            const double ax = s->vertex[3 * face[0] + axis], bx = s->vertex[3 * face[1] + axis];
            const double cx = s->vertex[3 * face[2] + axis];
            for (int j = 0; j < LANES; j++) {
                a[axis][j] = ax - at[axis][j];
                b[axis][j] = bx - at[axis][j];
                c[axis][j] = cx - at[axis][j];
            }
        }
        for (int j = 0; j < LANES; j++) {
            double ax = a[0][j], ay = a[1][j], az = a[2][j], bx = b[0][j], by = b[1][j];
            double bz = b[2][j], cx = c[0][j], cy = c[1][j], cz = c[2][j];
            double ra = sqrt(ax * ax + ay * ay + az * az), rb = sqrt(bx * bx + by * by + bz * bz);
            double rc = sqrt(cx * cx + cy * cy + cz * cz);
            double triple = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz)
                            + az * (bx * cy - by * cx);
            double below = ra * rb * rc + (ax * bx + ay * by + az * bz) * rc
                           + (bx * cx + by * cy + bz * cz) * ra + (cx * ax + cy * ay + cz * az) * rb;
            total[j] += compute_arctan2(triple, below);
        }
    }
    for (int j = 0; j < count; j++)
        s->winding[start + j] = total[j] / 6.283185307179586477;
}

static int take_surface(Arrays *arrays, PyObject **objects, Surface *s)
{
    Py_ssize_t points[2] = {ANY, 3}, vertices[2] = {ANY, 3}, faces[2] = {ANY, 3};
    int is_valid = (s->point = take_array(arrays, objects[0], "points", 'd', READ, 2, points)) &&
                   (s->vertex = take_array(arrays, objects[1], "vertices", 'd', READ, 2, vertices)) &&
                   (s->face = take_array(arrays, objects[2], "faces", 'q', READ, 2, faces)) &&
                   check_indices(s->face, 3 * faces[0], vertices[0], "faces");
    s->points = points[0], s->vertices = vertices[0], s->faces = faces[0];
    return is_valid;
}

PyObject *closest_points(PyObject *module, PyObject *arguments)
{
    Arrays arrays = {.count = 0};
    Surface s;
    PyObject *objects[3], *boxed, *name, *box, *square, *nearest, *position;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "OOOO!OOO", &objects[0], &objects[1], &objects[2],
                          &PyTuple_Type, &boxed, &square, &nearest, &position) ||
        !PyArg_ParseTuple(boxed, "OO", &name, &box))
        return NULL;
    int is_valid = take_surface(&arrays, objects, &s);
    s.boxes = (s.faces + FACES_PER_BOX - 1) / FACES_PER_BOX;
    Py_ssize_t places[2] = {s.points, 3}, boxes[3] = {s.boxes, 2, 3};
    is_valid = is_valid && (s.name = take_array(&arrays, name, "names", 'q', READ, 1, &s.faces)) &&
               (s.box = take_array(&arrays, box, "boxes", 'd', READ, 3, boxes)) &&
               (s.square = take_array(&arrays, square, "squares", 'd', WRITE, 1, &s.points)) &&
               (s.nearest = take_array(&arrays, nearest, "nearest", 'q', WRITE, 1, &s.points)) &&
               (s.position = take_array(&arrays, position, "positions", 'd', WRITE, 2, places)) &&
               check_indices(s.name, s.faces, s.faces, "names");
    if (is_valid) {
        Py_BEGIN_ALLOW_THREADS
        for (Py_ssize_t start = 0; start < s.points; start += LANES)
            find_closest(&s, start);
        Py_END_ALLOW_THREADS
    }
    release_arrays(&arrays);
    return is_valid ? Py_NewRef(Py_None) : NULL;
}

PyObject *winding_numbers(PyObject *module, PyObject *arguments)
{
    Arrays arrays = {.count = 0};
    Surface s;
    PyObject *objects[3], *winding;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "OOOO", &objects[0], &objects[1], &objects[2], &winding))
        return NULL;
    int is_valid = take_surface(&arrays, objects, &s) &&
                   (s.winding = take_array(&arrays, winding, "winding", 'd', WRITE, 1, &s.points));
    if (is_valid) {
        Py_BEGIN_ALLOW_THREADS
        for (Py_ssize_t start = 0; start < s.points; start += LANES)
            add_angles(&s, start);
        Py_END_ALLOW_THREADS
    }
    release_arrays(&arrays);
    return is_valid ? Py_NewRef(Py_None) : NULL;
}
