/* Dense factorisations: see dense.c. All matrices are stored by rows. */
#ifndef SPATIAL_PIN_DENSE_H
#define SPATIAL_PIN_DENSE_H

#include "kernel.h"

EXPORT Int dense_lu(Int n, Real *a, Int *order);
EXPORT void dense_lu_solve(Int n, const Real *lu, const Int *order, Int transposed, Int columns,
                           Real *x);
Real dense_inverse_norm(Int n, const Real *lu, const Int *order, Real *scratch);
Int dense_cholesky_solve(Int n, Real *a, Real *x, Real least);
EXPORT void dense_qr(Int m, Int n, Real *a, Int *order, Real *tau, Real *scratch);
EXPORT void dense_qr_turn(Int m, Int n, const Real *qr, const Real *tau, Int count, Int transposed,
                          Int columns, Real *x, Real *scratch);

#endif
