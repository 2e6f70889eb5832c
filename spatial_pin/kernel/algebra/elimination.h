/* The numbers of L U factors, in the order that was chosen: for sparse_lu.c, of every kind of Number. */

/* Values of the factors and inverse pivots. Returns the square of the largest entry of a row by its
   pivot. */
WITHIN Number find_factors(const SparseLU *lu, const Number *entry, Number *value, Number *inverse)
{
    const Int *target = lu->target;
    Number grown = SPREAD(0.0);
    memset(value, 0, (size_t)lu->n_values * sizeof *value);
    for (Int e = 0; e < lu->n_entries; e++)
        value[lu->position[e]] = entry[e];
    for (Int step = 0; step < lu->n; step++) {
        const Number by = inverse[step] = 1.0 / value[lu->pivot_at[step]];
        const Int first = lu->upper_start[step], end = lu->upper_start[step + 1];
        for (Int u = first; u < end; u++) {
            const Number part = value[lu->upper_at[u]] * by;
            grown = larger_number(grown, part * part);
        }
        for (Int l = lu->lower_start[step]; l < lu->lower_start[step + 1]; l++) {
            const Number factor = value[lu->lower_at[l]] *= by;
            for (Int u = first; u < end; u++)
                value[*target++] -= factor * value[lu->upper_at[u]];
        }
    }
    return grown;
}

/* x: right sides, then the solution; y (n): scratch. */
WITHIN void substitute(const SparseLU *lu, const Number *value, const Number *inverse, Number *y, Number *x)
{
    memcpy(y, x, (size_t)lu->n * sizeof *y);
    for (Int step = 0; step < lu->n; step++) {
        const Number known = y[lu->pivot_row[step]];
        if (N_PARTS == 1 && PART(known, 0) == 0.0)
            continue;
        for (Int l = lu->lower_start[step]; l < lu->lower_start[step + 1]; l++)
            y[lu->lower_row[l]] -= value[lu->lower_at[l]] * known;
    }
    for (Int step = lu->n - 1; step >= 0; step--) {
        Number sum = y[lu->pivot_row[step]];
        for (Int u = lu->upper_start[step]; u < lu->upper_start[step + 1]; u++)
            sum -= value[lu->upper_at[u]] * x[lu->upper_column[u]];
        x[lu->pivot_column[step]] = sum * inverse[step];
    }
}
