"""Functions of mechanisms in JAX and PyTorch, where these are installed, and the words if not."""

import sys

import numpy as np
import pytest
from loaded_library import library

import spatial_pin as sp


def made():
    mech = library("rssr")
    f = sp.function(mech, ["crank", "crank.rate", "b"], ["rocker_pin", "coupler_b.velocity"])
    return f, np.array([[1.0, 2.0, 0.381], [1.1, 2.0, 0.38]])


@pytest.mark.parametrize(("name", "method"), [("jax", "jax"), ("torch", "torch")])
def test_a_missing_framework_is_named(name, method, monkeypatch):
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(sp.SpatialPinError, match=rf"pip install 'spatial_pin\[{name}\]'"):
        getattr(made()[0], method)()


@pytest.mark.slow
def test_jax_has_the_same_derivatives_in_both_modes():
    jax = pytest.importorskip("jax")
    jax.config.update("jax_enable_x64", True)
    f, x = made()
    g, exact = f.jax(), f.jacobian(x)
    assert np.array_equal(g(x), f(x))
    for mode in (jax.jacfwd, jax.jacrev):
        assert np.asarray(jax.jit(jax.vmap(mode(g)))(x)) == pytest.approx(exact, abs=1e-14)
    with pytest.raises(sp.SpatialPinError, match="first derivatives only"):
        jax.hessian(lambda row: g(row).sum())(x[0])
    with pytest.raises(sp.SpatialPinError, match="closed in float64"):
        g(jax.numpy.asarray(x, dtype=np.float32))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.torch.jit:DeprecationWarning")  # PyTorch's own forward mode
def test_torch_has_the_same_derivatives_in_both_modes():
    torch = pytest.importorskip("torch")
    f, x = made()
    g, exact, rows = f.torch(), f.jacobian(x), torch.tensor(x)
    assert np.array_equal(g(x).numpy(), f(x))  # of an array too, as of JAX
    for mode in (torch.func.jacfwd, torch.func.jacrev):
        assert torch.func.vmap(mode(g))(rows).numpy() == pytest.approx(exact, abs=1e-14)
    assert torch.autograd.gradcheck(g, (rows.requires_grad_(),), check_forward_ad=True)
    (slope,) = torch.autograd.grad(g(rows).sum(), rows, create_graph=True)
    with pytest.raises(sp.SpatialPinError, match="first derivatives only"):
        slope.sum().backward()
    with pytest.raises(sp.SpatialPinError, match="closed in float64"):
        g(rows.float())
