"""USD: a stage that is opened, its units and the placements of its prims."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pinocchio as pin
from pxr import Ar, Sdf, Tf, Usd, UsdGeom, UsdPhysics, UsdUtils

from spatial_pin.errors import MechanismFileError
from spatial_pin.formats.file_access import REMEDY, Trust, check_file, shown
from spatial_pin.formats.urdf.elements import notice_of
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES

DEGREE = np.pi / 180.0
# Braces within one another: USD's reader of text, who calls itself for each, ends the process
# between 50,000 and 200,000 on a stack of 8 MB, before 20,000 on 1 MB.
DEEPEST_PRIM = 1000
EARTH = 9.81  # m/s², where a scene has the earth's gravity


class UsdStage:
    """An open stage; `trust` has the rule for the files that it may be composed of.

    Attributes:
        usd: the stage.
        where: the file, for errors.
        metre, kilogram: metres and kilograms in the stage's units.
        notices: of changes and omissions.
    """

    def __init__(self, path: Path, trust: Trust) -> None:
        layers = _layers(path, trust)  # held, so that none is opened a second time
        self.usd = usd = Usd.Stage.Open(str(path))
        del layers
        self.where = shown(path)
        self.metre = UsdGeom.GetStageMetersPerUnit(usd)
        self.kilogram = UsdPhysics.GetStageKilogramsPerUnit(usd)
        self.notices: list[str] = []
        self._turning: set[Any] = set()  # paths of prims whose turns are numbers
        self._cache = UsdGeom.XformCache(Usd.TimeCode.EarliestTime())
        for name, unit in (("metersPerUnit", self.metre), ("kilogramsPerUnit", self.kilogram)):
            if not (np.isfinite(unit) and unit > 0.0):
                raise MechanismFileError(f"{self.where}: {name} is {unit}; it must be positive")
        if not UsdGeom.StageHasAuthoredMetersPerUnit(usd):
            self.notices.append("metersPerUnit is not stated: lengths are centimetres, the default "
                                "of USD")
        missing = [str(error).split("\n")[0].strip() for error in usd.GetCompositionErrors()]
        if missing:
            self.notices.append(f"parts of the stage are missing: {'; '.join(missing)[:300]}")

    def prims(self, root: Any = None) -> Iterator[Any]:
        """Yield all prims below one, or all, those of instances too."""
        below = root if root is not None else self.usd.GetPseudoRoot()
        return iter(Usd.PrimRange(below, Usd.TraverseInstanceProxies(
            Usd.PrimIsActive & Usd.PrimIsDefined & ~Usd.PrimIsAbstract)))

    def placement(self, prim: Any, mirrored: bool = False) -> tuple[pin.SE3, Array]:
        """Return placement in the world [m] and scale (3,) of a prim; axes may be `mirrored`."""
        above = prim  # a turn by no number, which USD takes for none
        while above and above.GetPath() not in self._turning:
            self._turning.add(above.GetPath())
            for op in UsdGeom.Xformable(above).GetOrderedXformOps():
                value = op.GetAttr().Get(Usd.TimeCode.EarliestTime())
                if hasattr(value, "GetImaginary") and np.any(np.isnan(rotation_of(value))):
                    self.fail(above, f"{op.GetOpName()} is {value}; it must be a quaternion of "
                                     "finite numbers")
            above = above.GetParent()
        matrix = np.array(self._cache.GetLocalToWorldTransform(prim)).T
        axes = matrix[:3, :3]
        scale = np.linalg.norm(axes, axis=0)
        if mirrored and np.linalg.det(axes) < 0.0:
            axes = axes * [1.0, 1.0, -1.0]
        least = TOLERANCES.nothing * np.prod(scale)
        if not np.all(np.isfinite(matrix)) or np.linalg.det(axes) <= least:
            raise MechanismFileError(
                f"{self.where}: {prim.GetPath()}: its transform is flat, mirrored or no number; a "
                "body or joint needs right-handed axes")
        quaternion = pin.Quaternion(axes / scale).normalized()
        return pin.SE3(quaternion.matrix(), self.metre * matrix[:3, 3]), scale

    def fail(self, prim: Any, why: str) -> NoReturn:
        """Raise the error of a prim."""
        raise MechanismFileError(f"{self.where}: {prim.GetPath()}: {why}")

    def optional(self, prim: Any, name: str, default: float) -> float:
        """Return the number of a prim's attribute that other programs define."""
        attribute = prim.GetAttribute(name)
        return self.number(attribute) if attribute and attribute.HasValue() else default

    def numbers(self, attribute: Any, count: int = 1, infinite: bool = False) -> Array:
        """Return the (count,) numbers of an attribute."""
        value = attribute.Get() if attribute else None
        try:
            row = np.array(value, dtype=float).reshape(-1)
        except (TypeError, ValueError):
            row = np.empty(0)
        usable = ~np.isnan(row) if infinite else np.isfinite(row)
        if row.size != count or not np.all(usable):
            raise MechanismFileError(
                f"{self.where}: {attribute.GetPath()} is {str(value)[:80]}; it must be "
                f"{'a number' if count == 1 else f'{count} numbers'}")
        return row

    def number(self, attribute: Any) -> float:
        """Return the number of an attribute, which may be infinite."""
        return float(self.numbers(attribute, infinite=True)[0])

    def word(self, attribute: Any, valid: Collection[str]) -> str:
        """Return the text of an attribute."""
        text = str(attribute.Get())
        if text not in valid:
            raise MechanismFileError(f"{self.where}: {attribute.GetPath()} is {text[:80]!r}; it "
                                     f"must be one of {', '.join(valid)}")
        return text

    def rotation(self, attribute: Any) -> Array:
        """Return the rotation (3, 3) of an attribute, a quaternion."""
        value = attribute.Get()
        if not hasattr(value, "GetImaginary"):
            raise MechanismFileError(f"{self.where}: {attribute.GetPath()} is {str(value)[:80]}; "
                                     "it must be a quaternion")
        turn = rotation_of(value)
        if not np.all(np.isfinite(turn)):
            raise MechanismFileError(f"{self.where}: {attribute.GetPath()} is {str(value)[:80]}; "
                                     "it must be a quaternion of finite numbers")
        return turn

    def gravity(self) -> Array:
        """Return gravity (3,) [m/s²]: the scene's, else the earth's along the up axis."""
        up = np.eye(3)["XYZ".index(str(UsdGeom.GetStageUpAxis(self.usd)))]
        scene = next((UsdPhysics.Scene(x) for x in self.prims() if x.IsA(UsdPhysics.Scene)), None)
        if scene is None:
            return -EARTH * up
        direction = self.numbers(scene.GetGravityDirectionAttr(), 3)
        size = self.number(scene.GetGravityMagnitudeAttr())
        length = float(np.linalg.norm(direction))
        along = direction / length if length > 0.0 else -up
        return along * (size * self.metre if np.isfinite(size) and size >= 0.0 else EARTH)


def applied(prim: Any) -> list[str]:
    """Return all schemas applied to a prim, those that this USD does not know too."""
    stated = prim.GetMetadata("apiSchemas")
    return list(dict.fromkeys([*prim.GetAppliedSchemas(),
                               *(stated.GetAddedOrExplicitItems()
                                 if isinstance(stated, Sdf.TokenListOp) else ())]))


def brief_names(prims: Iterable[Any]) -> dict[str, str]:
    """Return a name for every prim by path: its own, or the path where others have that too."""
    own = {str(prim.GetPath()): prim.GetName() for prim in prims}
    counts = Counter(own.values())
    return {path: name if counts[name] == 1 and name != "universe" else path.strip("/")
            for path, name in own.items()}


def rotation_of(quaternion: Any) -> Array:
    """Return the rotation (3, 3) of a quaternion of USD, rounded or zero; NaN if not finite."""
    x, y, z = map(float, quaternion.GetImaginary())
    values = np.array([x, y, z, float(quaternion.GetReal())])
    if not np.all(np.isfinite(values)):
        return np.full((3, 3), np.nan)
    largest = float(np.abs(values).max())
    if largest == 0.0:
        return np.eye(3)
    values /= largest  # whose squares may leave the range of numbers
    values /= np.linalg.norm(values)
    if np.array_equal(np.abs(values), [0.0, 0.0, 0.0, 1.0]):
        return np.eye(3)
    return pin.Quaternion(values).matrix()


def _check_depth(path: Path, where: str) -> None:
    """Refuse text that is nested so deep that the reader of USD would die of it."""
    try:
        text = np.fromfile(path, dtype=np.uint8)
    except OSError:
        return  # USD has a message of its own
    if text[:5].tobytes() != b"#usda":
        return
    braces = text[(text == ord("{")) | (text == ord("}"))]
    if np.cumsum(np.where(braces == ord("{"), 1, -1)).max(initial=0) > DEEPEST_PRIM:
        raise MechanismFileError(f"{where}: more than {DEEPEST_PRIM} prims within one another; USD "
                                 "files of robots have ten")


def _layers(path: Path, trust: Trust) -> list[Any]:
    """Return the layers that a stage is composed of, each looked at before it is opened."""
    where, layers = shown(path), dict[str, Any]()
    waiting = [str(path)]
    while waiting:
        name = waiting.pop()
        file = Path(Sdf.Layer.SplitIdentifier(name)[0].partition("[")[0])
        if name in layers:
            continue
        try:
            resolved = trust.resolved(file) if layers else file
            if not os.path.exists(resolved):
                continue  # USD has a message of its own
            check_file(resolved)
        except MechanismFileError as error:
            raise MechanismFileError(f"{where}: it is composed of: {error}") from error
        _check_depth(resolved, where)
        layer = layers[name] = Sdf.Layer.FindOrOpen(name)
        for asset in _named(layer) if layer is not None else ():
            if not trust.trusted and Sdf.VariableExpression.IsExpression(asset):
                raise MechanismFileError(f"{where}: it is composed of {shown(asset)}, a name that "
                                         f"is worked out; {REMEDY}")
            name = layer.ComputeAbsolutePath(asset)  # and where USD looks for it
            waiting.append(str(Ar.GetResolver().Resolve(name)) or name)
    return list(layers.values())


def _named(layer: Any) -> Iterator[str]:
    """Yield the files that a layer is composed of, those of clips too."""
    yield from filter(None, layer.GetCompositionAssetDependencies())
    paths: list[Any] = []
    layer.Traverse(Sdf.Path.absoluteRootPath, paths.append)
    for path in paths:
        spec = layer.GetObjectAtPath(path)
        clips = spec.GetInfo("clips") if isinstance(spec, Sdf.PrimSpec) and spec.HasInfo(
            "clips") else {}
        for entries in clips.values():
            values = [entries.get(key) for key in ("assetPaths", "manifestAssetPath",
                                                   "templateAssetPath")]
            for value in values:
                several = value if isinstance(value, Sdf.AssetPathArray) else [value]
                yield from (getattr(x, "path", x) for x in several if x)


def leave_out(stage: UsdStage, names: Iterable[str]) -> list[str]:
    """Take prims of joints and the like out of a stage, by name or path; return a notice."""
    matches: dict[str, list[str]] = {name: [] for name in names}
    prims = {} if not matches else {
        prim: (prim.GetName(), str(prim.GetPath())) for prim in stage.prims()
        if not prim.HasAPI(UsdPhysics.RigidBodyAPI)}
    stage.usd.SetEditTarget(stage.usd.GetSessionLayer())
    for prim, own in prims.items():
        for name in matches.keys() & set(own):
            matches[name].append(str(prim.GetTypeName()))
            prim.SetActive(False)
    return notice_of(matches, [name for own in prims.values() for name in own], stage.where)


def _text(error: Exception) -> str:
    """Return the text of an error of USD; it may quote bytes that are no UTF-8."""
    try:
        return str(error)
    except UnicodeDecodeError as odd:
        return odd.object.decode(errors="replace")


@contextmanager
def quietly(path: Path) -> Iterator[None]:
    """Keep what USD prints from the terminal; its errors become the library's."""
    delegate = UsdUtils.CoalescingDiagnosticDelegate()
    try:
        yield
    except Tf.ErrorException as error:
        reasons = re.findall(r" : '(.*?)'\s*(?:Error in|$)", " ".join(_text(error).split()))
        reason = (reasons[0] if reasons else "it is no USD").replace(str(path), path.name)[:300]
        raise MechanismFileError(f"{shown(path)}: USD cannot read it: {reason}") from error
    finally:
        delegate.TakeUncoalescedDiagnostics()
