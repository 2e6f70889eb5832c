/* A number of each of a few configurations. */
#ifndef SPATIAL_PIN_LANE_H
#define SPATIAL_PIN_LANE_H

#include "vectors.h"

enum { LANES = 4 }; /* configurations, or right sides, at once */
typedef Real Lane __attribute__((vector_size(LANES * sizeof(Real)), aligned(sizeof(Real))));

#endif
