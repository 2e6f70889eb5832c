"""Inside of reductions: a verification whose sweeps are lost."""
from loaded_library import library

import spatial_pin as sp
from spatial_pin.reduction import verification as verification_of


def test_verify_ends_where_a_branch_is_lost(monkeypatch):
    """Whatever a sweep comes upon, what it had reached before is compared."""
    whole = verification_of.sweep

    def losing(mechanism, driver, values, *args, **keys):
        motion = whole(mechanism, driver, values, *args, **keys)
        kept = motion if len(motion) < 9 or abs(values[-1]) < 1.0 else whole(
            mechanism, driver, values[:9], *args, **keys)
        if kept is motion:
            return motion
        kept.events.append(sp.Event("lost", float(values[9]), 9, "end of the followed path"))
        raise sp.SingularError("lost", motion=kept)

    monkeypatch.setattr(verification_of, "sweep", losing)
    found = sp.reduce(library("rssr"), "rocker_pin").verify()
    assert found.rows > 0 and found.worst < 1e-9
    assert "rows over crank from " in found.compared[0]
