"""Gradient checks of functions of mechanisms, on every mechanism of the library.

    python scripts/gradients.py                     # NumPy, JAX and PyTorch, those installed
    python scripts/gradients.py --only rssr delta

Each mechanism is a function of its drivers' values, rates and accelerations and of its dimensions.
Derivatives are compared with central differences of eighth order (at 1e-9 of the size of outputs of
a kind), and those of a framework by its own check of both modes (at 1e-6, differences of second
order). It is no part of CI, as the wheels of the frameworks are large; the tests do the first part.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np

import spatial_pin as sp

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))

from differences import differences, far_off, moving_function

OURS, THEIRS = 1e-9, 1e-6
STEP = 1e-5  # of a framework's differences: their error is then below 1e-9


def outputs_of(mech: sp.Mechanism) -> list[str]:
    """Return outputs that the drivers determine: coordinates, a frame, efforts."""
    name = [c for c in mech.coordinates if mech.coordinate(c).q >= 0][-1]
    return [name, f"{name}.rate", f"{name}.acceleration", f"{mech.links[-1]}.position",
            f"{mech.links[-1]}.acceleration", *(f"effort.{d}" for d in mech.drivers)]


def in_jax(f: sp.Function, x: np.ndarray, sizes: np.ndarray) -> None:
    """Check both modes, compiled ones too; raises where they fail."""
    import jax
    from jax.test_util import check_grads

    jax.config.update("jax_enable_x64", True)
    units = scale_of(f, x, sizes)
    g = f.jax()
    check_grads(lambda u: jax.jit(g)(u * sizes) / units, (jax.numpy.array(x / sizes),), order=1,
                modes=("fwd", "rev"), atol=THEIRS, rtol=THEIRS, eps=STEP)


def in_torch(f: sp.Function, x: np.ndarray, sizes: np.ndarray) -> None:
    """Check both modes; raises where they fail."""
    import torch

    units, size = (torch.tensor(a) for a in (scale_of(f, x, sizes), sizes))
    g = f.torch()
    torch.autograd.gradcheck(lambda u: g(u * size) / units,
                             (torch.tensor(x / sizes, requires_grad=True),),
                             eps=STEP, atol=THEIRS, rtol=THEIRS, check_forward_ad=True)


def scale_of(f: sp.Function, x: np.ndarray, sizes: np.ndarray) -> Any:
    """Return the sizes (k,) of outputs: of their values and slopes."""
    values, slopes = f.value_and_jacobian(x)
    return np.maximum(1e-3, np.maximum(np.abs(values), np.abs(slopes * sizes).max(axis=1)))


FRAMEWORKS = {"jax": in_jax, "torch": in_torch}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--only", nargs="+", default=sp.list_mechanisms())
    names = parser.parse_args().only
    warnings.simplefilter("ignore")
    installed = [name for name in FRAMEWORKS if importlib.util.find_spec(name)]
    print(f"{'mechanism':22} {'ours':>8}  {'  '.join(f'{n:>8}' for n in installed)}  ms a row")
    failed = 0
    for name in names:
        mech = sp.load(name)
        f, x, sizes = moving_function(sp, mech, outputs_of(mech), list(mech.dimensions)[:3])
        values, exact = f.value_and_jacobian(x)
        begin = time.process_time()
        f.value_and_jacobian(x)
        spent = 1e3 * (time.process_time() - begin)
        error = far_off(f, exact, differences(f, x, sizes), values, sizes)
        words = []
        for framework in installed:
            try:
                FRAMEWORKS[framework](f, x, sizes)
                words.append("good")
            except (AssertionError, RuntimeError) as problem:
                words.append("FAILED")
                print(f"{name}: {framework}: {problem}", file=sys.stderr)
        failed += error > OURS or "FAILED" in words
        print(f"{name:22} {error:8.1e}  {'  '.join(f'{w:>8}' for w in words)}  {spent:8.1f}",
              flush=True)
    sys.exit(f"{failed} of {len(names)} mechanisms failed" if failed else 0)


if __name__ == "__main__":
    main()
