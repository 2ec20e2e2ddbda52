/* The logarithm and the arctangent of lanes, which compilers turn into vector instructions. */

#ifndef CAGEIK_FUNCTIONS_H
#define CAGEIK_FUNCTIONS_H

#include <math.h>
#include <string.h>

#include "kernel.h"

INLINE double from_bits(uint64_t bits)
{
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

INLINE uint64_t to_bits(double value)
{
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

/* Coefficients and constants that `tests/method/weights/bem/derive_functions.py` derives. The second
   number of a pair is what the first leaves. */
static const double LOG[] = {0.6666666666666734, 0.3999999999941468, 0.28571428742387184,
                             0.22222198573230587, 0.18183564323914897, 0.15314050601677748,
                             0.14795949275754364};
static const double ARCTAN[] = {-0.33333333333333154, 0.1999999999995208, -0.1428571428124961,
                                0.11111110901216399, -0.09090903254818097, 0.07692203006396633,
                                -0.0666539083088972, 0.05871455804255224, -0.051968272222914516,
                                0.04472534716103532, -0.034463140204489554, 0.020142344556160444,
                                -0.006309425808015779};
static const double LN_2[] = {0.6931471805598903, 5.497923018708371e-14};
static const double PI[] = {3.141592653589793, 1.2246467991473532e-16};

INLINE double evaluate_polynomial(const double *coefficient, int count, double z)
{
    double value = coefficient[count - 1];
    for (int k = count - 2; k >= 0; k--)
        value = value * z + coefficient[k];
    return value;
}

/* Natural logarithm of a normal positive number, within 1 ulp; NaN of one that is not finite.
   x = 2^k (1 + f) with 1 + f around 1; with s = f / (2 + f) and z = s^2, its logarithm is
   2 s + s z P(z), and 2 s = f - s f. */
INLINE double compute_log(double x)
{
    const uint64_t root_half = 0x3fe6a09e00000000u, one = 0x3ff0000000000000u;
    const uint64_t two_52 = 0x4330000000000000u, mantissa = 0x000fffffffffffffu;
    uint64_t bits = to_bits(x) + (one - root_half);
    double k = from_bits((bits >> 52) | two_52) - (0x1p52 + 1023);
    double f = from_bits((bits & mantissa) + root_half) - 1;
    double s = f / (2 + f), z = s * s;
    double rest = s * (f - z * evaluate_polynomial(LOG, 7, z)) - k * LN_2[1];
    return ((f - rest) + k * LN_2[0]) + (x - x);
}

/* arctan2(y, x) of finite numbers, within 2 ulp; 0 or pi when both are zero. Slopes up to 0.55 are
   taken as they are, those up to 1 from pi/4, and others from pi/2. */
INLINE double compute_arctan2(double y, double x)
{
    double a = fabs(x), b = fabs(y);
    double large = a > b ? a : b, small = a > b ? b : a;
    int is_steep = small > 0.55 * large;
    double t = (is_steep ? small - large : small) / (is_steep ? small + large : large);
    t = large > 0 ? t : 0;
    double z = t * t, angle = t * (z * evaluate_polynomial(ARCTAN, 13, z)) + t;
    angle = is_steep ? (angle + PI[1] / 4) + PI[0] / 4 : angle;
    angle = b > a ? (PI[1] / 2 - angle) + PI[0] / 2 : angle;
    angle = x < 0 ? (PI[1] - angle) + PI[0] : angle;
    return copysign(angle, y);
}

#endif
