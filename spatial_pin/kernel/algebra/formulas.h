/* Vectors of three Numbers, polynomials, and rotations, stored by columns: R[3 * c + i] is entry i of column c.
 *
 * It is included once for every kind of Number. */

WITHIN Number dot3(const Number *a, const Number *b)
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

WITHIN void cross3(const Number *a, const Number *b, Number *out)
{
    const Number x = a[1] * b[2] - a[2] * b[1];
    const Number y = a[2] * b[0] - a[0] * b[2];
    const Number z = a[0] * b[1] - a[1] * b[0];
    out[0] = x;
    out[1] = y;
    out[2] = z;
}

WITHIN void copy3(const Number *a, Number *out)
{
    out[0] = a[0];
    out[1] = a[1];
    out[2] = a[2];
}

WITHIN void zero3(Number *out) { out[0] = out[1] = out[2] = SPREAD(0.0); }

/* out = factor * a */
WITHIN void multiple3(Number factor, const Number *a, Number *out)
{
    out[0] = factor * a[0];
    out[1] = factor * a[1];
    out[2] = factor * a[2];
}

/* out += factor * a */
WITHIN void add3(Number factor, const Number *a, Number *out)
{
    out[0] += factor * a[0];
    out[1] += factor * a[1];
    out[2] += factor * a[2];
}

/* out = R v */
WITHIN void rotate3(const Number *R, const Number *v, Number *restrict out)
{
    for (int i = 0; i < 3; i++)
        out[i] = R[i] * v[0] + R[3 + i] * v[1] + R[6 + i] * v[2];
}

/* out = A B, both rotations */
WITHIN void product3(const Number *A, const Number *B, Number *out)
{
    for (int c = 0; c < 3; c++)
        rotate3(A, B + 3 * c, out + 3 * c);
}

/* Columns of the rotation of a unit quaternion. */
WITHIN void quaternion_rotation(const Number *quaternion, Number *R)
{
    const Number x = quaternion[0], y = quaternion[1], z = quaternion[2], w = quaternion[3];
    const Number xx = 2.0 * x * x, yy = 2.0 * y * y, zz = 2.0 * z * z;
    const Number xy = 2.0 * x * y, xz = 2.0 * x * z, yz = 2.0 * y * z;
    const Number wx = 2.0 * w * x, wy = 2.0 * w * y, wz = 2.0 * w * z;
    R[0] = 1.0 - yy - zz, R[1] = xy + wz, R[2] = xz - wy;
    R[3] = xy - wz, R[4] = 1.0 - xx - zz, R[5] = yz + wx;
    R[6] = xz + wy, R[7] = yz - wx, R[8] = 1.0 - xx - yy;
}

/* out = quaternion * (w, 0) */
WITHIN void times_pure(const Number *quaternion, const Number *w, Number *out)
{
    cross3(quaternion, w, out);
    add3(quaternion[3], w, out);
    out[3] = -dot3(quaternion, w);
}

/* Value and first two derivatives (3) of a polynomial, by ascending powers, at x. */
WITHIN void polynomial_at(const Real *c, Int degree, Number x, Number *out)
{
    Number value = SPREAD(c[degree]), first = SPREAD(0.0), half = SPREAD(0.0);
    for (Int d = degree - 1; d >= 0; d--) {
        half = half * x + first;
        first = first * x + value;
        value = value * x + c[d];
    }
    out[0] = value;
    out[1] = first;
    out[2] = 2.0 * half;
}
