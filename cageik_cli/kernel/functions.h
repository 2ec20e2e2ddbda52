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

/* Natural logarithm of a normal positive number, within 1 ulp; NaN of one that is not finite.
   After FreeBSD's e_log.c (Sun Microsystems 1993): x = 2^k m with m around 1, and with
   s = (m - 1) / (m + 1), ln m = 2 artanh s by a polynomial in s^2. */
INLINE double compute_log(double x)
{
    const uint64_t root_half = 0x3fe6a09e00000000u, one = 0x3ff0000000000000u;
    const uint64_t two_52 = 0x4330000000000000u, mantissa = 0x000fffffffffffffu;
    uint64_t bits = to_bits(x) + (one - root_half);
    double k = from_bits((bits >> 52) | two_52) - (0x1p52 + 1023);
    double f = from_bits((bits & mantissa) + root_half) - 1;
    double s = f / (2 + f), z = s * s, w = z * z, half_square = 0.5 * f * f;
    double even = w * (3.999999999940941908e-01
                       + w * (2.222219843214978396e-01 + w * 1.531383769920937332e-01));
    double odd = z * (6.666666666666735130e-01
                      + w * (2.857142874366239149e-01
                             + w * (1.818357216161805012e-01 + w * 1.479819860511658591e-01)));
    double tail = s * (half_square + (odd + even)) + k * 1.90821492927058770002e-10;
    return (tail - half_square + f + k * 6.93147180369123816490e-01) + (x - x);
}

/* arctan2(y, x) of finite numbers, within 2 ulp; 0 or pi when both are zero. After Cephes' atan.c
   (Moshier 1984 to 1995): a rational function up to 0.66, and around pi/4 above it. */
INLINE double compute_arctan2(double y, double x)
{
    double a = fabs(x), b = fabs(y);
    double large = a > b ? a : b, small = a > b ? b : a;
    int is_steep = small > 0.66 * large;
    double t = (is_steep ? small - large : small) / (is_steep ? small + large : large);
    t = large > 0 ? t : 0;
    double z = t * t;
    double p = (((-8.750608600031904122785E-1 * z - 1.615753718733365076637E1) * z
                 - 7.500855792314704667340E1) * z - 1.228866684490136173410E2) * z
               - 6.485021904942025371773E1;
    double q = ((((z + 2.485846490142306297962E1) * z + 1.650270098316988542046E2) * z
                 + 4.328810604912902668951E2) * z + 4.853903996359136964868E2) * z
               + 1.945506571482613964425E2;
    double angle = t * (z * p / q) + t;
    angle = is_steep ? (angle + 3.061616997868382943E-17) + 7.85398163397448309616E-1 : angle;
    angle = b > a ? (6.123233995736765886E-17 - angle) + 1.57079632679489661923 : angle;
    angle = x < 0 ? (1.2246467991473531772E-16 - angle) + 3.14159265358979323846 : angle;
    return copysign(angle, y);
}

#endif
