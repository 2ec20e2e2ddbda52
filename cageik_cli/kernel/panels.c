/* Potentials of panels at points, in closed form, for a fixed number of points at a time.

   The formulas and their symbols are those of the Python modules `panels` and `higher_terms`, whose
   functions are the reference for this file: each array here is a lane per point. */

#include <stdlib.h>

#include "functions.h"

enum { LANES = 32, MAX_ORDER = 5, MAX_TERMS = (MAX_ORDER + 1) * (MAX_ORDER + 2) / 2 };

typedef double Row[LANES];

typedef struct {
    double edge_on, min_gap, near_edge, closed, inside, fade;
} Limits;

typedef struct {
    Py_ssize_t vertices, panels, edges, hats, points, near, high, sums, terms;
    int order, is_inside;
    const Limits *limits;
    const double *vertex, *length, *area, *altitude, *half_slope, *form, *point;
    const int64_t *corner, *end, *side_edge, *first_side;
    const int32_t *hat_start, *hat;
    const double *hat_value;
    const int64_t *near_panel, *high_panel;
    const double *centroid, *reach, *factor, *metric, *basis;
    double *linear, *higher, *layer;
} Problem;

/* What is known of the points of one step. */
typedef struct {
    Row x, y, z, angle_sum, largest;
    int64_t largest_panel[LANES];
    Row *distance, *log, *moment, *product, *layer;
} Step;

INLINE void evaluate_form(const double *form, const Step *step, double *out)
{
    for (int j = 0; j < LANES; j++)
        out[j] = form[0] * step->x[j] + form[1] * step->y[j] + form[2] * step->z[j] + form[3];
}

INLINE double evaluate_form_at(const double *form, const Step *step, int j)
{
    return form[0] * step->x[j] + form[1] * step->y[j] + form[2] * step->z[j] + form[3];
}

INLINE void measure_distances(const double *place, const Step *step, double *out)
{
    for (int j = 0; j < LANES; j++) {
        double x = place[0] - step->x[j], y = place[1] - step->y[j], z = place[2] - step->z[j];
        out[j] = sqrt(x * x + y * y + z * z);
    }
}

/* The gap r_a + r_b - L beside an edge, from the distance to its line (`_recompute_small_gaps`). */
static void recompute_gaps(const Problem *p, const Step *step, Py_ssize_t edge, double *gap,
                           const double *product)
{
    Py_ssize_t panel = p->first_side[edge] / 3, side = p->first_side[edge] % 3;
    const double *form = p->form + 4 * panel;
    const double altitude = p->altitude[side * p->panels + panel], length = p->length[edge];
    for (int j = 0; j < LANES; j++) {
        double dot = product[j] / 2;
        if (!(gap[j] < p->limits->near_edge * length && dot < 0))
            continue;
        double h = evaluate_form_at(form, step, j);
        double x = evaluate_form_at(form + 4 * p->panels, step, j);
        double y = evaluate_form_at(form + 8 * p->panels, step, j);
        double t = altitude * ((side == 0 ? x : side == 1 ? y : -x - y) + 1.0 / 3);
        double total = gap[j] + length, other = (total * total - length * length) / 2 - dot;
        gap[j] = 2 * length * length * (t * t + h * h) / ((other - dot) * (total + length));
    }
}

INLINE void fill_edges(const Problem *p, Step *step)
{
    for (Py_ssize_t edge = 0; edge < p->edges; edge++) {
        const double *a = step->distance[p->end[2 * edge]], *b = step->distance[p->end[2 * edge + 1]];
        const double length = p->length[edge], limit = p->limits->near_edge * length;
        const double least = p->limits->min_gap * length;
        double *product = step->product[edge], *log = step->log[edge], *moment = step->moment[edge];
        Row gap, along;
        double smallest = HUGE_VAL;
        for (int j = 0; j < LANES; j++) {
            double total = a[j] + b[j];
            gap[j] = total - length;
            product[j] = (total + length) * gap[j] - 2 * (a[j] * b[j]);
            smallest = gap[j] < smallest ? gap[j] : smallest;
        }
        if (smallest < limit)
            recompute_gaps(p, step, edge, gap, product);
        evaluate_form(p->form + 4 * (3 * p->panels + edge), step, along);
        for (int j = 0; j < LANES; j++) {
            double s = along[j], f = gap[j] > least ? gap[j] : least;
            f = compute_log((a[j] + b[j] + length) / f);
            log[j] = f;
            moment[j] = (a[j] * a[j] - s * s) * f + (b[j] - a[j]) * s + b[j] * length;
        }
    }
}

INLINE void add_to_hats(const Problem *p, Step *step, Py_ssize_t column, const double *integral)
{
    for (int32_t k = p->hat_start[column]; k < p->hat_start[column + 1]; k++) {
        double *out = step->layer[p->hat[k]];
        for (int j = 0; j < LANES; j++)
            out[j] += p->hat_value[k] * integral[j];
    }
}

INLINE void store_row(const Problem *p, double *out, Py_ssize_t row, Py_ssize_t start,
                      const double *values)
{
    Py_ssize_t count = p->points - start < LANES ? p->points - start : LANES;
    memcpy(out + row * p->points + start, values, (size_t)count * sizeof(double));
}

INLINE void fill_panel(const Problem *p, Step *step, Py_ssize_t i, Py_ssize_t start)
{
    const Py_ssize_t n = p->panels;
    const int64_t *corner = p->corner + 3 * i, *side = p->side_edge + 3 * i;
    const double *r0 = step->distance[corner[0]], *r1 = step->distance[corner[1]];
    const double *r2 = step->distance[corner[2]];
    const double *p0 = step->product[side[0]], *p1 = step->product[side[1]];
    const double *p2 = step->product[side[2]];
    const double *f0 = step->log[side[0]], *f1 = step->log[side[1]], *f2 = step->log[side[2]];
    const double *b0 = step->moment[side[0]], *b1 = step->moment[side[1]];
    const double *b2 = step->moment[side[2]];
    const double a0 = p->altitude[i], a1 = p->altitude[n + i], a2 = p->altitude[2 * n + i];
    const double *u = p->half_slope + i, *v = u + 3 * n;
    const double u0 = u[0], u1 = u[n], u2 = u[2 * n], v0 = v[0], v1 = v[n], v2 = v[2 * n];
    const double four_areas = 4 * p->area[i], edge_on = p->is_inside ? -1 : p->limits->edge_on;
    Row h, x, y, angle, sum[3], layer[2];
    evaluate_form(p->form + 4 * i, step, h);
    evaluate_form(p->form + 4 * (n + i), step, x);
    evaluate_form(p->form + 4 * (2 * n + i), step, y);
    for (int j = 0; j < LANES; j++) {
        double below = 2 * (r0[j] * r1[j] * r2[j]) + r0[j] * p0[j] + r1[j] * p1[j] + r2[j] * p2[j];
        double omega = 2 * compute_arctan2(four_areas * h[j], below);
        angle[j] = fabs(h[j]) < edge_on ? 0 : omega;
    }
    for (int j = 0; j < LANES; j++) {
        double size = fabs(angle[j]);
        step->angle_sum[j] += angle[j];
        step->largest_panel[j] = size > step->largest[j] ? i : step->largest_panel[j];
        step->largest[j] = size > step->largest[j] ? size : step->largest[j];
    }
    for (int j = 0; j < LANES; j++) {
        double total = (a0 * f0[j] + a1 * f1[j] + a2 * f2[j]) / 3 - h[j] * angle[j]
                       + x[j] * (a0 * f0[j] - a2 * f2[j]) + y[j] * (a1 * f1[j] - a2 * f2[j]);
        sum[0][j] = total;
        sum[1][j] = x[j] * total + (u0 * b0[j] + u1 * b1[j] + u2 * b2[j]);
        sum[2][j] = y[j] * total + (v0 * b0[j] + v1 * b1[j] + v2 * b2[j]);
        layer[0][j] = x[j] * angle[j] - 2 * h[j] * (u0 * f0[j] + u1 * f1[j] + u2 * f2[j]);
        layer[1][j] = y[j] * angle[j] - 2 * h[j] * (v0 * f0[j] + v1 * f1[j] + v2 * f2[j]);
    }
    for (int k = 0; k < 3; k++)
        store_row(p, p->linear, k * n + i, start, sum[k]);
    add_to_hats(p, step, i, angle);
    add_to_hats(p, step, n + i, layer[0]);
    add_to_hats(p, step, 2 * n + i, layer[1]);
}

/* Adds what is missing of 4 pi to the largest angle of points inside (`close_solid_angles`). */
static void close_angles(const Problem *p, Step *step, Py_ssize_t start, int count)
{
    const double whole = 12.566370614359172954;
    const Py_ssize_t n = p->panels;
    for (int j = 0; j < count; j++) {
        double missing = whole - step->angle_sum[j], size = fabs(missing);
        if (!(size > p->limits->closed && size < whole * p->limits->inside))
            continue;
        Py_ssize_t i = step->largest_panel[j];
        double h = evaluate_form_at(p->form + 4 * i, step, j);
        double foot[3] = {1, evaluate_form_at(p->form + 4 * (n + i), step, j),
                          evaluate_form_at(p->form + 4 * (2 * n + i), step, j)};
        for (int k = 0; k < 3; k++) {
            Py_ssize_t column = k * n + i;
            p->linear[column * p->points + start + j] -= foot[k] * h * missing;
            for (int32_t m = p->hat_start[column]; m < p->hat_start[column + 1]; m++)
                step->layer[p->hat[m]][j] += p->hat_value[m] * foot[k] * missing;
        }
    }
}

/* The strength of terms beyond linear (`_find_near_panels`); returns whether any is above 0. */
INLINE int measure_strength(const Problem *p, const Step *step, Py_ssize_t high, double *out)
{
    const double reach = p->reach[high], fade = p->limits->fade, span = fade - 1 / fade;
    double most = 0;
    measure_distances(p->centroid + 3 * high, step, out);
    for (int j = 0; j < LANES; j++) {
        double share = (fade - out[j] / reach) / span;
        share = share > 0 ? share : 0;
        share = share < 1 ? share : 1;
        out[j] = share * share * (3 - 2 * share);
        most = out[j] > most ? out[j] : most;
    }
    return most > 0;
}

/* J_0 to J_(order - 1) of an edge (`_edge_powers`). */
INLINE void fill_powers(const Problem *p, const Step *step, Py_ssize_t edge, Row *power)
{
    const double per_length = 1 / p->length[edge];
    const double *a = step->distance[p->end[2 * edge]], *b = step->distance[p->end[2 * edge + 1]];
    Row middle, square, cube_a, cube_b;
    evaluate_form(p->form + 4 * (3 * p->panels + edge), step, middle);
    for (int j = 0; j < LANES; j++) {
        double ra = a[j] * per_length, rb = b[j] * per_length;
        middle[j] = middle[j] * per_length + 0.5;
        square[j] = (ra * ra + rb * rb) / 2 - 0.25;
        cube_a[j] = ra * ra * ra;
        cube_b[j] = rb * rb * rb;
        power[0][j] = step->moment[edge][j] * (per_length * per_length / 2);
    }
    double half = 1;
    for (int k = 1; k < p->order; k++, half /= 2) {
        const double share = 1.0 / (k + 2), sign = k % 2 ? -1 : 1;
        for (int j = 0; j < LANES; j++) {
            double found = (cube_b[j] + sign * cube_a[j]) * (half * share)
                           - middle[j] * power[k - 1][j] * ((2 * k + 1) * share);
            power[k][j] = k < 2 ? found : found - square[j] * power[k - 2][j] * ((k - 1) * share);
        }
    }
}

INLINE void add_product(double *total, double factor, const double *first, const double *second)
{
    for (int j = 0; j < LANES; j++)
        total[j] += factor * first[j] * second[j];
}

INLINE void sum_sides(const double *factor, int count, Row *power, double *out)
{
    for (int j = 0; j < LANES; j++)
        out[j] = 0;
    for (int k = 0; k < count; k++)
        if (factor[k] != 0)
            for (int j = 0; j < LANES; j++)
                out[j] += factor[k] * power[k][j];
}

/* Index of the monomial x^a y^b. */
INLINE int find_monomial(int a, int b)
{
    return (a + b) * (a + b + 1) / 2 + b;
}

/* K of all monomials of one panel (`_Recurrences`). The side sums are used in the order in which
   `_side_sum_places` lists them. `single` has those of 1, x and y. */
INLINE void fill_single(const Problem *p, const double *factor, Py_ssize_t panel, Row *foot,
                        const double *square, Row *power, Row *single)
{
    const int width = 3 * p->order;
    const Py_ssize_t n = p->panels;
    const double *metric = p->metric + panel;
    Row radial[MAX_TERMS], sum;
    for (int degree = 2; degree <= p->order; degree++) {
        for (int b = 0, low = degree - 2; b <= low; b++) {
            int a = low - b;
            double *found = radial[find_monomial(a, b)];
            sum_sides(factor, width, power, found);
            add_product(found, 1, square, single[find_monomial(a, b)]);
            for (int axis = 0; axis < 2; axis++) {
                sum_sides(factor + (1 + axis) * width, width, power, sum);
                add_product(found, 1, foot[axis], sum);
            }
            factor += 3 * width;
            if (a)
                add_product(found, a, foot[0], radial[find_monomial(a - 1, b)]);
            if (b)
                add_product(found, b, foot[1], radial[find_monomial(a, b - 1)]);
            for (int j = 0; j < LANES; j++)
                found[j] /= 3 + low;
        }
        for (int b = 0; b <= degree; b++) {
            int axis = b == degree, c = axis ? 0 : degree - b - 1, d = axis ? b - 1 : b;
            double *found = single[find_monomial(degree - b, b)];
            sum_sides(factor, width, power, found);
            factor += width;
            add_product(found, 1, foot[axis], single[find_monomial(c, d)]);
            for (int other = 0; other < 2; other++) {
                int times = other ? d : c;
                if (!times)
                    continue;
                double share = -times * metric[(2 * axis + other) * n];
                const double *lower = radial[find_monomial(c - !other, d - other)];
                for (int j = 0; j < LANES; j++)
                    found[j] += share * lower[j];
            }
        }
    }
}

INLINE void fill_higher(const Problem *p, Step *step, Py_ssize_t k, Py_ssize_t start)
{
    const Py_ssize_t high = p->near_panel[k], panel = p->high_panel[high], n = p->panels;
    const int terms = (int)p->terms, count = p->points - start < LANES ? (int)(p->points - start) : LANES;
    Row strength, foot[2], square, power[3 * MAX_ORDER], single[MAX_TERMS], out;
    if (!measure_strength(p, step, high, strength)) {
        memset(out, 0, sizeof out);
        for (int t = 3; t < terms; t++)
            store_row(p, p->higher, (t - 3) * p->near + k, start, out);
        return;
    }
    for (int side = 0; side < 3; side++)
        fill_powers(p, step, p->side_edge[3 * panel + side], power + side * p->order);
    evaluate_form(p->form + 4 * panel, step, square);
    evaluate_form(p->form + 4 * (n + panel), step, foot[0]);
    evaluate_form(p->form + 4 * (2 * n + panel), step, foot[1]);
    for (int j = 0; j < LANES; j++)
        square[j] *= square[j];
    memset(single, 0, 3 * sizeof(Row));
    for (int t = 0; t < 3; t++)
        memcpy(single[t], p->linear + (t * n + panel) * p->points + start,
               (size_t)count * sizeof(double));
    fill_single(p, p->factor + high * p->sums * 3 * p->order, panel, foot, square, power, single);
    for (int t = 3; t < terms; t++) {
        sum_sides(p->basis + (t - 3) * terms, terms, single, out);
        for (int j = 0; j < LANES; j++)
            out[j] *= strength[j];
        store_row(p, p->higher, (t - 3) * p->near + k, start, out);
    }
}

FOR_EACH_PROCESSOR
static void fill_step(const Problem *p, Step *step, Py_ssize_t start)
{
    const int count = p->points - start < LANES ? (int)(p->points - start) : LANES;
    for (int j = 0; j < LANES; j++) {
        const double *point = p->point + 3 * (start + (j < count ? j : count - 1));
        step->x[j] = point[0], step->y[j] = point[1], step->z[j] = point[2];
        step->angle_sum[j] = 0, step->largest[j] = -1, step->largest_panel[j] = 0;
    }
    memset(step->layer, 0, (size_t)p->hats * sizeof(Row));
    for (Py_ssize_t i = 0; i < p->vertices; i++)
        measure_distances(p->vertex + 3 * i, step, step->distance[i]);
    fill_edges(p, step);
    for (Py_ssize_t i = 0; i < p->panels; i++)
        fill_panel(p, step, i, start);
    if (p->is_inside)
        close_angles(p, step, start, count);
    for (Py_ssize_t k = 0; k < p->near; k++)
        fill_higher(p, step, k, start);
    for (Py_ssize_t k = 0; k < p->hats; k++)
        store_row(p, p->layer, k, start, step->layer[k]);
}

static int fill_all(const Problem *p)
{
    if (p->points == 0)
        return 1; /* of any number of hats, for which there may be no memory */
    size_t rows = (size_t)(p->vertices + 3 * p->edges + p->hats);
    char *memory = malloc((rows + 1) * sizeof(Row));
    if (memory == NULL)
        return 0;
    /* At a multiple of a row's size, so that no vector of lanes crosses a cache line. */
    Row *row = (Row *)(((uintptr_t)memory + 63) / 64 * 64);
    Step step;
    step.distance = row, row += p->vertices;
    step.log = row, row += p->edges;
    step.moment = row, row += p->edges;
    step.product = row, row += p->edges;
    step.layer = row;
    for (Py_ssize_t start = 0; start < p->points; start += LANES)
        fill_step(p, &step, start);
    free(memory);
    return 1;
}

static int take_panels(Arrays *arrays, PyObject *objects, Problem *p)
{
    PyObject *vertex, *corner, *end, *side_edge, *first_side, *length, *area, *altitude, *slope, *form;
    if (!PyArg_ParseTuple(objects, "OOOOOOOOOO", &vertex, &corner, &end, &side_edge, &first_side,
                          &length, &area, &altitude, &slope, &form))
        return 0;
    Py_ssize_t three[2] = {ANY, 3};
    if (!(p->vertex = take_array(arrays, vertex, "vertices", 'd', READ, 2, three)))
        return 0;
    p->vertices = three[0], three[0] = ANY;
    if (!(p->corner = take_array(arrays, corner, "corners", 'q', READ, 2, three)))
        return 0;
    p->panels = three[0];
    if (p->panels == 0) {
        PyErr_SetString(PyExc_ValueError, "corners: expected a panel at least");
        return 0;
    }
    Py_ssize_t two[2] = {ANY, 2};
    if (!(p->end = take_array(arrays, end, "edge ends", 'q', READ, 2, two)))
        return 0;
    p->edges = two[0];
    Py_ssize_t n = p->panels, by_three[2] = {3, n}, slopes[3] = {2, 3, n};
    Py_ssize_t forms[2] = {3 * n + p->edges, 4};
    return (p->side_edge = take_array(arrays, side_edge, "side edges", 'q', READ, 2, three)) &&
           (p->first_side = take_array(arrays, first_side, "first sides", 'q', READ, 1, &p->edges)) &&
           (p->length = take_array(arrays, length, "edge lengths", 'd', READ, 1, &p->edges)) &&
           (p->area = take_array(arrays, area, "areas", 'd', READ, 1, &n)) &&
           (p->altitude = take_array(arrays, altitude, "altitudes", 'd', READ, 2, by_three)) &&
           (p->half_slope = take_array(arrays, slope, "half slopes", 'd', READ, 3, slopes)) &&
           (p->form = take_array(arrays, form, "linear forms", 'd', READ, 2, forms)) &&
           check_indices(p->corner, 3 * n, p->vertices, "corners") &&
           check_indices(p->end, 2 * p->edges, p->vertices, "edge ends") &&
           check_indices(p->side_edge, 3 * n, p->edges, "side edges") &&
           check_indices(p->first_side, p->edges, 3 * n, "first sides");
}

static int take_hats(Arrays *arrays, PyObject *objects, Problem *p)
{
    PyObject *start, *hat, *value;
    if (!PyArg_ParseTuple(objects, "OOO", &start, &hat, &value))
        return 0;
    Py_ssize_t starts = 3 * p->panels + 1, count = ANY;
    if (!(p->hat_start = take_array(arrays, start, "hat starts", 'i', READ, 1, &starts)) ||
        !(p->hat = take_array(arrays, hat, "hats", 'i', READ, 1, &count)) ||
        !(p->hat_value = take_array(arrays, value, "hat values", 'd', READ, 1, &count)))
        return 0;
    int is_valid = p->hat_start[0] == 0 && p->hat_start[starts - 1] == count;
    for (Py_ssize_t k = 1; k < starts; k++)
        is_valid &= p->hat_start[k] >= p->hat_start[k - 1];
    for (Py_ssize_t k = 0; is_valid && k < count; k++)
        is_valid &= p->hat[k] >= 0 && p->hat[k] < p->hats;
    if (!is_valid)
        PyErr_SetString(PyExc_ValueError, "hats: expected rows of a sparse matrix");
    return is_valid;
}

static int take_terms(Arrays *arrays, PyObject *objects, Problem *p)
{
    PyObject *near, *panel, *centroid, *reach, *factor, *metric, *basis;
    if (!PyArg_ParseTuple(objects, "iOOOOOOO", &p->order, &near, &panel, &centroid, &reach, &factor,
                          &metric, &basis))
        return 0;
    if (p->order < 2 || p->order > MAX_ORDER) {
        PyErr_Format(PyExc_ValueError, "order %d: expected 2 to %d", p->order, MAX_ORDER);
        return 0;
    }
    p->near = p->high = ANY;
    p->terms = (p->order + 1) * (p->order + 2) / 2;
    p->sums = 0;
    for (int degree = 2; degree <= p->order; degree++)
        p->sums += 3 * (degree - 1) + degree + 1;
    if (!(p->near_panel = take_array(arrays, near, "near panels", 'q', READ, 1, &p->near)) ||
        !(p->high_panel = take_array(arrays, panel, "high panels", 'q', READ, 1, &p->high)))
        return 0;
    Py_ssize_t places[2] = {p->high, 3}, factors[3] = {p->high, p->sums, 3 * p->order};
    Py_ssize_t metrics[3] = {2, 2, p->panels}, bases[2] = {p->terms - 3, p->terms};
    return (p->centroid = take_array(arrays, centroid, "centroids", 'd', READ, 2, places)) &&
           (p->reach = take_array(arrays, reach, "reach", 'd', READ, 1, &p->high)) &&
           (p->factor = take_array(arrays, factor, "side factors", 'd', READ, 3, factors)) &&
           (p->metric = take_array(arrays, metric, "metric", 'd', READ, 3, metrics)) &&
           (p->basis = take_array(arrays, basis, "basis", 'd', READ, 2, bases)) &&
           check_indices(p->near_panel, p->near, p->high, "near panels") &&
           check_indices(p->high_panel, p->high, p->panels, "high panels");
}

static int take_results(Arrays *arrays, PyObject *objects, Problem *p)
{
    PyObject *linear, *higher, *layer;
    if (!PyArg_ParseTuple(objects, "OOO", &linear, &higher, &layer))
        return 0;
    Py_ssize_t columns[2] = {3 * p->panels, p->points}, rows[2] = {ANY, p->points};
    Py_ssize_t terms[3] = {p->terms - 3, p->near, p->points};
    p->linear = take_array(arrays, linear, "linear", 'd', WRITE, 2, columns);
    p->higher = p->linear ? take_array(arrays, higher, "higher", 'd', WRITE, 3, terms) : NULL;
    p->layer = p->higher ? take_array(arrays, layer, "layer", 'd', WRITE, 2, rows) : NULL;
    p->hats = rows[0];
    return p->layer != NULL;
}

PyObject *compute_potentials(PyObject *module, PyObject *arguments)
{
    Arrays arrays = {.count = 0};
    Problem p = {.terms = 3};
    PyObject *limits, *panels, *hats, *terms, *point, *results;
    Py_ssize_t limit_count = sizeof(Limits) / sizeof(double), places[2] = {ANY, 3};
    (void)module;
    int is_valid = PyArg_ParseTuple(arguments, "OO!O!OOpO!", &limits, &PyTuple_Type, &panels,
                                    &PyTuple_Type, &hats, &terms, &point, &p.is_inside,
                                    &PyTuple_Type, &results);
    if (is_valid && terms != Py_None && !PyTuple_Check(terms)) {
        PyErr_SetString(PyExc_TypeError, "terms: expected a tuple or None");
        is_valid = 0;
    }
    is_valid = is_valid && (p.point = take_array(&arrays, point, "points", 'd', READ, 2, places));
    p.points = places[0];
    is_valid = is_valid &&
               (p.limits = take_array(&arrays, limits, "limits", 'd', READ, 1, &limit_count)) &&
               take_panels(&arrays, panels, &p) &&
               (terms == Py_None || take_terms(&arrays, terms, &p)) &&
               take_results(&arrays, results, &p) && take_hats(&arrays, hats, &p);
    if (is_valid) {
        int has_memory;
        Py_BEGIN_ALLOW_THREADS
        has_memory = fill_all(&p);
        Py_END_ALLOW_THREADS
        if (!has_memory)
            is_valid = 0, PyErr_NoMemory();
    }
    release_arrays(&arrays);
    return is_valid ? Py_NewRef(Py_None) : NULL;
}

FOR_EACH_PROCESSOR
static void fill_functions(const double *y, const double *x, double *log, double *angle,
                           Py_ssize_t count)
{
    for (Py_ssize_t k = 0; k < count; k++)
        log[k] = compute_log(x[k]);
    for (Py_ssize_t k = 0; k < count; k++)
        angle[k] = compute_arctan2(y[k], x[k]);
}

PyObject *compute_functions(PyObject *module, PyObject *arguments)
{
    Arrays arrays = {.count = 0};
    PyObject *objects[4];
    double *data[4];
    Py_ssize_t count = ANY;
    (void)module;
    int is_valid = PyArg_ParseTuple(arguments, "OOOO", &objects[0], &objects[1], &objects[2],
                                    &objects[3]);
    for (int k = 0; is_valid && k < 4; k++)
        is_valid = (data[k] = take_array(&arrays, objects[k], "numbers", 'd', k < 2 ? READ : WRITE,
                                         1, &count)) != NULL;
    if (is_valid)
        fill_functions(data[0], data[1], data[2], data[3], count);
    release_arrays(&arrays);
    return is_valid ? Py_NewRef(Py_None) : NULL;
}
