/* What counts as round-off, as zero, as closed, as singular: the same numbers as in Python.
   Each has its reason there, in numerics/tolerances.py; a test holds the two equal. */
#ifndef SPATIAL_PIN_TOLERANCES_H
#define SPATIAL_PIN_TOLERANCES_H

#define TOLERANCE_LAST_DIGIT 1e-15
#define TOLERANCE_ROUND_OFF 1e-14
#define TOLERANCE_ZERO 1e-13
#define TOLERANCE_TIGHT 1e-12
#define TOLERANCE_CLOSED 1e-11
#define TOLERANCE_RANK 1e-10
#define TOLERANCE_NOTHING 1e-9
#define TOLERANCE_SINGULAR 1e-7
#define TOLERANCE_HALF_PRECISION 1e-6
#define TOLERANCE_NEAR_SINGULAR 1e-5
#define TOLERANCE_REGULAR 1e-4
#define TOLERANCE_WELL_CONDITIONED 1e-3
#define TOLERANCE_CONTRACTION 0.25
#define TOLERANCE_UNEXPLAINED 0.1
#define TOLERANCE_LONGEST_STEP 1.0
#define TOLERANCE_DAMPED_STEP 0.5
#define TOLERANCE_TRIAL_STEP 1e-2

#endif
