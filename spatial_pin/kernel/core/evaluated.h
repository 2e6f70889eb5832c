/* Memory for what evaluations write: included once for every kind of Number. */

WITHIN void make_room_of(Kernel *k, Evaluated *s)
{
    const Int n = k->n_joints, nv = k->nv, np = k->products.n, ne = k->n_equations;
    const Int vectors = 3 * k->vectors.n, na = k->n_angles, nx = k->quantities.n;
    struct {
        Number **to;
        Int count;
    } fields[] = {
        {&s->q, k->nq}, {&s->R, 9 * n}, {&s->p, 3 * n}, {&s->linear, 3 * nv}, {&s->angular, 3 * nv},
        {&s->omega, 3 * n}, {&s->velocity, 3 * n}, {&s->alpha, 3 * n}, {&s->acceleration, 3 * n},
        {&s->entry, k->entry_start[ne]}, {&s->residual, k->n_closure}, {&s->angle, na},
        {&s->angle_reference, na}, {&s->right, nv}, {&s->vectors.value, vectors},
        {&s->vectors.rate, vectors}, {&s->vectors.bias, vectors}, {&s->products.A, 3 * np},
        {&s->products.B, 3 * np}, {&s->products.value, np}, {&s->products.rate, np},
        {&s->products.bias, np}, {&s->products.weight, np}, {&s->angles.rate, na},
        {&s->angles.bias, na}, {&s->angles.weight, na},
        {&s->quantities.last, 4 * k->quantities.n_functions}, {&s->quantities.value, nx},
        {&s->quantities.rate, nx}, {&s->quantities.bias, nx}, {&s->quantities.slope, nx},
        {&s->quantities.bend, nx}, {&s->equations.bias, ne}, {&s->equations.row, nv},
    };
    for (size_t i = 0; i < sizeof fields / sizeof *fields; i++)
        *fields[i].to = kernel_memory(k, fields[i].count, sizeof(Number));
    s->products.weighted = kernel_ints(k, np);
    s->products.is_weighted = kernel_memory(k, np, 1);
    s->moves = kernel_ints(k, n);
}
