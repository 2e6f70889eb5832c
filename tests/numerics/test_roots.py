"""Where a function changes its sign, also one that is round-off there."""

import numpy as np
import pytest

from spatial_pin.numerics.roots import sign_change


@pytest.mark.parametrize("ends", [(0.0, 2.0), (2.0, 0.0)], ids=["ahead", "back"])
def test_a_zero_is_found_in_either_direction(ends):
    function = np.cos
    found = sign_change(function, *ends, *map(function, ends))
    assert found == pytest.approx(np.pi / 2, abs=1e-14)


def test_the_signs_of_the_ends_are_those_given_whatever_the_function_says_there_later():
    asked = []

    def noise(x):
        asked.append(x)
        return 1.0

    assert sign_change(noise, 0.0, 1.0, 1e-17, -1e-17) == 1.0
    assert not {0.0, 1.0} & set(asked)


@pytest.mark.parametrize("at_ends, place", [((1e-17, 3e-17), 0.0), ((-3e-17, -1e-17), 1.0),
                                            ((0.0, 1.0), 0.0), ((-1.0, 0.0), 1.0)], ids=str)
def test_ends_of_one_sign_have_the_change_at_the_smaller_value(at_ends, place):
    assert sign_change(lambda x: 1.0, 0.0, 1.0, *at_ends) == place


def test_a_place_without_a_number_lies_behind_the_change():
    found = sign_change(lambda x: 0.3 - x if x < 0.8 else np.nan, 0.0, 1.0, 0.3, -0.7)
    assert found == pytest.approx(0.3, abs=1e-14)
    found = sign_change(lambda x: 1.0 if x < 0.8 else np.nan, 0.0, 1.0, 1.0, -1.0)
    assert found == pytest.approx(0.8, abs=1e-13)


def test_a_jump_far_from_the_middle_is_found_to_all_digits():
    function = lambda x: 1e-300 if x < 1e-9 else -1e300  # noqa: E731
    found = sign_change(function, 0.0, 1.0, 1e-300, -1e300)
    assert found == pytest.approx(1e-9, abs=2e-14)
