"""The tolerances of the library: one object, in units of machine epsilon and characteristic length.

Numbers that are compared with them have no unit: lengths are divided by the characteristic
length, angles are in radians, rates and singular values are divided by the largest of their kind,
equations are of order one. So a mechanism of 1e-30 m decides as one of 1e30 m does.

Three facts give most of the values. Of 160 random mechanisms and those of the library, closed
loops were open by at most 1e-15, along sweeps by 3e-15; redundant equations had singular values
up to 1e-15, independent ones down to 1e-4 (down to 1e-3 along sweeps of the library). A matrix
whose smallest pivot is s of the largest magnifies round-off by 1/s: a configuration is known to
eps/s, its rates to eps/s². And a function whose derivative vanishes has its zero at the square root
of round-off, 1.5e-8.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

EPS = float(np.finfo(float).eps)


@dataclass(frozen=True)
class Tolerances:
    """Bounds of round-off, of zero, of a closed loop, of singular and of small.

    Attributes:
        last_digit: what a few operations on numbers of order one leave, 4.5 epsilon: such as one
            product of placements, or one number read from decimals of all digits.
        round_off: a residual or correction that cannot be made smaller, 45 epsilon: three times
            the largest closure error of all sweeps measured.
        zero: a singular value, pivot or entry that is zero in matrices of order one, 450 epsilon:
            round-off of sums of some hundred terms, a hundred times the measured one.
        tight: a difference of two numbers that are the same but for how each was computed, from
            placements composed of some hundred others, 4500 epsilon. And the residual to which
            loops with redundant equations are closed before the redundant ones are determined.
        closed: the closure error up to which loops count as closed where round-off is magnified:
            a thousand times `round_off`, which pivots down to 1e-3 leave; single precision, the
            finest that opens a loop in earnest, leaves 2e-7.
        rank: singular values, relative to the largest, below which they count as zero: in the
            geometric middle of the 1e-15 of redundant equations and the 1e-5 of `near_singular`.
        nothing: a rate, length or angle, relative to the largest of its kind, that is none: in the
            middle of `tight`, which round-off does not reach in regular configurations, and
            `half_precision`, below which no true rate is.
        singular: the smallest pivot, relative to the largest, of a configuration that has rates:
            eps/s² is 2 % there, and their first digit is lost at half as much.
        half_precision: of numbers known to half of the digits. A singular configuration is known to
            the square root of round-off, 1.5e-8, and so are singular values there; two ways to one
            configuration differ by as much, or by the loosest tolerance, 1e-8. A hundred times
            that: configurations farther apart are two, singular values above it are not zero.
        near_singular: the pivot below which a path has the better parameter in its arc length:
            the driver's rates have lost ten of sixteen digits, 2e-6.
        regular: the pivot above which nothing is looked at again: rates have eight digits, 2e-8.
        well_conditioned: the pivot above which even error estimates are left out: rates have ten
            digits, 2e-10, and independent equations are that well conditioned as a rule.
        contraction: the largest ratio of two Newton corrections in a row. Kantorovich's theorem
            has a root where his h is at most 1/2, and bounds the ratio by h / (2 (1 - h)): a
            quarter is h = 1/3, whose next ratio is below a fourteenth.
        unexplained: the part of a step that its prediction may miss. A neighbouring branch is as
            far away as the step is long; a tenth of it leaves no doubt.
        longest_step: how far joints go in one step of a path [rad, characteristic lengths]. At one
            radian sine and cosine differ from their Taylor polynomials of third order by 1/24,
            less than half of `unexplained`.
        damped_step: how far one joint goes in one step of Newton's method far from closure: at
            half a radian the terms it leaves out are an eighth, so that most of a step is right.
        trial_step: the length of trial motions: long relative to the square root of round-off, to
            which singular configurations are known (1e-6 of it), short relative to one radian.
        moved: the part of a trial motion that is left after closing the loops if the mechanism
            moves: all but the square of its length (1e-2), or nothing; between these any will do.
        largest: the largest number that is worked with: its square and third power are numbers.
    """

    last_digit: float = 1e-15
    round_off: float = 1e-14
    zero: float = 1e-13
    tight: float = 1e-12
    closed: float = 1e-11
    rank: float = 1e-10
    nothing: float = 1e-9
    singular: float = 1e-7
    half_precision: float = 1e-6
    near_singular: float = 1e-5
    regular: float = 1e-4
    well_conditioned: float = 1e-3
    contraction: float = 0.25
    unexplained: float = 0.1
    longest_step: float = 1.0
    damped_step: float = 0.5
    trial_step: float = 1e-2
    moved: float = 0.3
    largest: float = 1e100


TOLERANCES = Tolerances()
