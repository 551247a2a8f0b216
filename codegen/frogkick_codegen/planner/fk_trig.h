/* fk_trig.h - sine and cosine near zero, for the planner's own files. */
#ifndef FK_TRIG_H
#define FK_TRIG_H

#include "fk_internal.h"

/* sin r = r + r^3 S(r^2), cos r = 1 - r^2 / 2 + r^4 C(r^2) for |r| <= pi / 4 + 0.001: least-maximum fits
 * (Lawson's iteration), error before rounding to float32 4e-9 and 1e-10, written with 9 digits, which name
 * a float32 exactly. */
#define FK_SIN_0 (-0.166666552f)
#define FK_SIN_1 0.00833215471f
#define FK_SIN_2 (-0.000195144545f)
#define FK_COS_0 0.0416666456f
#define FK_COS_1 (-0.00138873595f)
#define FK_COS_2 2.44375333e-05f

#define FK_SMALL_ANGLE_RAD 0.785f /* up to here fk_sincos() takes no quarter turn away: the same bits */

static inline void fk_sincos_small(float angle_rad, float *sine, float *cosine)
{
    const float square = angle_rad * angle_rad;

    *sine = angle_rad + angle_rad * square * (FK_SIN_0 + square * (FK_SIN_1 + square * FK_SIN_2));
    *cosine = (1.0f - 0.5f * square) + square * square * (FK_COS_0 + square * (FK_COS_1 + square * FK_COS_2));
}

#endif
