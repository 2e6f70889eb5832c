/* A number of each of a few configurations. */
#ifndef SPATIAL_PIN_LANE_H
#define SPATIAL_PIN_LANE_H

#include "vectors.h"

#define LANES 4 /* configurations at once */
typedef Real Lane __attribute__((vector_size(LANES * sizeof(Real)), aligned(sizeof(Real))));

/* Functions compiled twice, where the system chooses one for the processor: with vectors of four, or of two.
   Both do the same, to the last bit. */
#if defined(__GNUC__) && !defined(__clang__) && defined(__x86_64__) && defined(__GLIBC__)
#define FOR_WIDE __attribute__((target_clones("avx2", "default")))
#else
#define FOR_WIDE
#endif

#endif
