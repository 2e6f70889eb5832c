/* Whatever is included from here on is compiled for lanes: the Number of formulas is a Lane. */
#ifndef SPATIAL_PIN_SIDE_BY_SIDE_H
#define SPATIAL_PIN_SIDE_BY_SIDE_H

#include "lane.h"

#undef Number
#undef N_PARTS
#undef PART
#undef SPREAD
#undef SHARED
#undef larger_number
#define Number Lane
#define N_PARTS LANES
#define PART(x, i) ((x)[i])
#define SPREAD(x) ((x) - (Lane){0}) /* also of what is a lane */
#define SHARED WITHIN

#undef Evaluated
#undef kernel_of
#define Evaluated Abreast /* see lanes.h */
#define kernel_of(s) ((s)->k)

#define dot3 lanes_dot3
#define cross3 lanes_cross3
#define copy3 lanes_copy3
#define zero3 lanes_zero3
#define multiple3 lanes_multiple3
#define add3 lanes_add3
#define rotate3 lanes_rotate3
#define product3 lanes_product3
#define quaternion_rotation lanes_quaternion_rotation
#define times_pure lanes_times_pure
#define polynomial_at lanes_polynomial_at
#include "formulas.h"
#undef add3
#undef multiple3
#define add3(factor, a, out) lanes_add3(SPREAD(factor), a, out)
#define multiple3(factor, a, out) lanes_multiple3(SPREAD(factor), a, out)

typedef Int LaneMask __attribute__((vector_size(LANES * sizeof(Int)), aligned(sizeof(Int))));

WITHIN Lane larger_number(Lane most, Lane size)
{
    const LaneMask is_larger = size > most;
    return (Lane)((is_larger & (LaneMask)size) | (~is_larger & (LaneMask)most));
}

#endif
