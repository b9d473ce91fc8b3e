"""A model as built-in types that `json` writes, and back."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import Any, cast, get_args

import attrs

from imgscale._checks import as_float, as_known_image_size, check_choice, nan_as_none
from imgscale._reading import cut, quoted
from imgscale._typing import Box, DepthKind, FitMethod, SizeAxis
from imgscale.camera import Camera
from imgscale.depth import GroundPlane
from imgscale.fitted_plane import FittedPlane
from imgscale.flags import Flag, flag_names, flags_of
from imgscale.noise import Noise
from imgscale.object_prior import ObjectPrior
from imgscale.priors import PriorTable
from imgscale.reference import Reference
from imgscale.shared_scale import SharedReference, SharedScale

__all__ = ["fields_from", "record_of"]

_SCHEMA = 4
# What a broken record makes Python say, as constructors take their arguments from it.
_BROKEN = (ArithmeticError, AttributeError, LookupError, TypeError, ValueError)


def record_of(model: Any) -> dict[str, Any]:
    """
    Turn a model into built-in types.

    Parameters
    ----------
    model : ScaleModel
        The model.

    Returns
    -------
    dict
        With a "schema" entry; floats that are not finite become None.
    """
    record = attrs.asdict(model, recurse=True, value_serializer=_plain)
    record["priors"] = [attrs.asdict(row, value_serializer=_plain) for row in model.priors]
    return {"schema": _SCHEMA, **record}


def fields_from(record: Mapping[str, Any], names: Collection[str]) -> dict[str, Any]:
    """
    Read the fields of a model.

    Parameters
    ----------
    record : mapping
        What `record_of` returned, also after a round trip through JSON.
    names : collection of str
        The names of the model's fields.

    Returns
    -------
    dict
        The fields.

    Raises
    ------
    TypeError
        If it is no mapping.
    ValueError
        If it is of another schema, lacks a field, or holds what no model holds.
    """
    if not isinstance(cast("object", record), Mapping):
        msg = f"`record` must be a mapping, as `to_dict` writes it; got {type(record).__name__}."
        raise TypeError(msg)
    fields = dict(record)
    if fields.pop("schema", None) != _SCHEMA:
        msg = f"`record` must have schema {_SCHEMA}; got {quoted(record.get('schema'))}."
        raise ValueError(msg)
    if fields.keys() != set(names):
        odd = ", ".join(sorted(map(str, fields.keys() ^ set(names))))
        msg = cut(f"`record` must have the fields that `to_dict` writes; got others: {odd}.")
        raise ValueError(msg)
    try:
        return _read(fields)
    except _BROKEN as error:
        msg = cut(f"`record` must hold what `to_dict` writes; it is broken: {error}")
        raise ValueError(msg) from error


def _read(fields: dict[str, Any]) -> dict[str, Any]:
    """Build what is no plain number or word."""
    fields["references"] = tuple(_reference(item) for item in fields["references"])
    fields["flags"] = flags_of(fields["flags"])
    fields["priors"] = PriorTable([ObjectPrior(**item) for item in fields["priors"]])
    fields["noise"] = Noise(**fields["noise"])
    kinds = (("camera", Camera), ("ground", GroundPlane), ("plane", FittedPlane))
    for name, kind in kinds:
        fields[name] = None if fields[name] is None else kind(**fields[name])
    fields["shared"] = None if fields["shared"] is None else _shared(fields["shared"])
    size = fields["image_size"]
    fields["image_size"] = None if size is None else as_known_image_size(size)
    if fields["mean_depth"] is None:
        fields["mean_depth"] = math.nan
    check_choice("kind", fields["kind"], get_args(DepthKind))
    check_choice("method", fields["method"], get_args(FitMethod))
    _check_numbers(fields)
    plane, shared = fields["plane"], fields["shared"]
    parts = [*fields["references"], *fields["priors"], *([plane] if plane else [])]
    parts += [shared, *shared.own, *shared.others] if shared else []
    for part in parts:
        for field in attrs.fields(part.__class__):
            _check_kind(field.name, str(field.type), getattr(part, field.name))
    for name, law in _PLAIN.items():
        _check_kind(name, law, fields[name])
    return fields


# What the model's own numbers are; those of its parts are told by their classes.
_PLAIN = {
    "correlation": "finite number", "mean_depth": "float", "scale_rel_std": "finite number",
    "depth_rel": "finite number | None", "fingerprint": "int | None",
}  # fmt: skip


def _check_kind(name: str, kind: str, value: object) -> None:
    """Raise where a word, a truth value or no value stands for a number, or the reverse."""
    laws: dict[str, bool] = {
        "str": isinstance(value, str),
        "bool": isinstance(value, bool),
        "int": _is_number(value) and isinstance(value, int),
        "float": _is_number(value),
        "finite number": _is_number(value) and not math.isnan(as_float(cast("float", value))),
        "SizeAxis": value in get_args(SizeAxis) if isinstance(value, str) else False,
        "Box": _are_numbers(value, 4) and None not in map(nan_as_none, cast("Box", value)),
        "tuple[float, float]": _are_numbers(value, 2),
        "tuple[float, float, float]": _are_numbers(value, 3),
    }
    *maybe, wanted = sorted(kind.split(" | "), key="None".__ne__)
    if not (laws.get(wanted, True) or (maybe and value is None)):
        msg = f"`{name}` must be {kind}; got {quoted(value)}."
        raise TypeError(msg)


def _is_number(value: object) -> bool:
    is_real = isinstance(value, (int, float)) and not isinstance(value, bool)
    return is_real and not math.isinf(as_float(cast("float", value)))


def _are_numbers(value: object, count: int) -> bool:
    listed = cast("tuple[object, ...]", value) if isinstance(value, tuple) else ()
    return len(listed) == count and all(map(_is_number, listed))


def _check_numbers(fields: Mapping[str, Any]) -> None:
    """Raise unless the numbers are such as a fit finds."""
    laws = {"k": "positive", "k_std": ">= 0", "shift": "finite", "shift_std": ">= 0"}
    for name, law in laws.items():
        value = fields[name]
        good = _is_number(value) and not math.isnan(value)
        if not good or (law != "finite" and value < 0) or (law == "positive" and value == 0):
            msg = f"`{name}` must be a finite number{'' if law == 'finite' else f', {law}'}; "
            raise ValueError(msg + f"got {quoted(value)}.")


def _plain(_: object, __: object, value: Any) -> Any:
    """Make one field JSON-ready; tables are written apart."""
    if isinstance(value, Flag):
        return flag_names(value)
    if isinstance(value, PriorTable):
        return None
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _shared(item: Mapping[str, Any]) -> SharedScale:
    fields: dict[str, Any] = {name: item[name] for name in item.keys() - {"own", "others"}}
    return SharedScale(
        own=tuple(SharedReference(**row) for row in item["own"]),
        others=tuple(SharedReference(**row) for row in item["others"]),
        **fields,
    )


def _reference(item: Mapping[str, Any]) -> Reference:
    fields: dict[str, Any] = {
        name: math.nan if value is None else value for name, value in item.items()
    }
    fields["xyxy"] = tuple(fields["xyxy"])
    foot = item["foot_xy"]
    fields["foot_xy"] = tuple(math.nan if number is None else number for number in foot)
    return Reference(**fields)
