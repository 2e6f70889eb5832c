"""Functions of mechanisms for JAX and PyTorch, with the derivatives of the closed loops."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np

from spatial_pin.errors import SpatialPinError

TWICE = ("a function of a mechanism has first derivatives only: for second ones differentiate "
         "`f.jacobian` by differences, or use `solve_rates` and `jacobian_rate`")


def _installed(name: str, title: str) -> ModuleType:
    """Return a package.

    Raises:
        SpatialPinError: it is not installed.
    """
    import importlib

    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise SpatialPinError(
            f"a function for {title} needs it: pip install 'spatial_pin[{name}]'") from error


def _not_double(title: str, dtype: Any, remedy: str) -> SpatialPinError:
    return SpatialPinError(f"{title}: loops are closed in float64, and x is {dtype}: {remedy}")


def jax_function(f: Any) -> Callable[[Any], Any]:
    """Return a `Function` as one of a JAX array; see `Function.jax`."""
    jax = _installed("jax", "JAX")
    jnp, (m, k) = jax.numpy, (len(f.inputs), len(f.labels))
    double = jnp.float64

    def on_rows(work: Callable[[Any], Any], *shape: int) -> Callable[[Any], Any]:
        """Return a function of NumPy, for inputs (..., m), as one of JAX."""
        def host(x: Any) -> Any:
            rows = np.asarray(x)
            return work(rows.reshape(-1, m)).reshape(*rows.shape[:-1], *shape)

        def call(x: Any) -> Any:
            result = jax.ShapeDtypeStruct((*x.shape[:-1], *shape), double)
            return jax.pure_callback(host, result, x, vmap_method="expand_dims")

        return call

    value, slopes = on_rows(f, k), jax.custom_jvp(on_rows(f.jacobian, k, m))

    @slopes.defjvp
    def refuse(primals: Any, tangents: Any) -> Any:
        raise SpatialPinError(TWICE)

    outputs = jax.custom_jvp(value)

    @outputs.defjvp
    def tangent(primals: Any, tangents: Any) -> Any:
        (x,), (dx,) = primals, tangents
        return outputs(x), jnp.einsum("...km,...m->...k", slopes(x), dx)

    def call(x: Any) -> Any:
        x = jnp.asarray(x)
        if x.dtype != double and jnp.issubdtype(x.dtype, jnp.floating):
            raise _not_double("JAX", x.dtype, "jax.config.update('jax_enable_x64', True) before "
                              "arrays are made")
        if not x.ndim or x.shape[-1] != m:
            raise ValueError(f"x has shape {x.shape}; (..., {m}) is needed: {', '.join(f.inputs)}")
        return outputs(x.astype(double))

    return call


def torch_function(f: Any) -> Callable[[Any], Any]:
    """Return a `Function` as one of a PyTorch tensor; see `Function.torch`."""
    torch, m = _installed("torch", "PyTorch"), len(f.inputs)
    outputs = _torch_operators(torch, f, m, len(f.labels))

    def call(x: Any) -> Any:
        x = torch.as_tensor(x)
        if x.dtype != torch.float64:
            raise _not_double("PyTorch", x.dtype, "make it with dtype=torch.float64")
        if not x.ndim or x.shape[-1] != m:
            raise ValueError(f"x has shape {tuple(x.shape)}; (..., {m}) is needed: "
                             f"{', '.join(f.inputs)}")
        return outputs.apply(x)

    return call


def _torch_operators(torch: Any, f: Any, m: int, k: int) -> Any:
    """Return the outputs (..., k) of inputs (..., m) as an operator of PyTorch."""
    def on_rows(x: Any, work: Callable[[Any], Any], *shape: int) -> Any:
        rows = x.detach().cpu().numpy()
        out = work(rows.reshape(-1, m)).reshape(*rows.shape[:-1], *shape)
        return torch.from_numpy(out).to(x.device)

    class Operator(torch.autograd.Function):  # type: ignore[misc,name-defined]
        @staticmethod
        def setup_context(ctx: Any, inputs: Any, output: Any) -> None:
            ctx.save_for_backward(*inputs)
            ctx.save_for_forward(*inputs)

        @classmethod
        def vmap(cls, info: Any, in_dims: Any, x: Any) -> Any:
            return cls.apply(x.movedim(in_dims[0], 0)), 0

    class Slopes(Operator):
        @staticmethod
        def forward(x: Any) -> Any:
            return on_rows(x, f.jacobian, k, m)

        @staticmethod
        def backward(ctx: Any, *changes: Any) -> Any:
            raise SpatialPinError(TWICE)

        jvp = backward

    class Outputs(Operator):
        @staticmethod
        def forward(x: Any) -> Any:
            return on_rows(x, f, k)

        @staticmethod
        def backward(ctx: Any, y: Any) -> Any:
            return (y[..., None, :] @ Slopes.apply(*ctx.saved_tensors))[..., 0, :]

        @staticmethod
        def jvp(ctx: Any, dx: Any) -> Any:
            return (Slopes.apply(*ctx.saved_tensors) @ dx[..., None])[..., 0]

    return Outputs
