"""A fault file (TOML): a seed, and a table `[[fault]]` for each fault."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import ErrorDetails

from drivers.errors import UsageError
from drivers.toml_lines import line_of
from simulators.faults.line import Stall, Unplug
from simulators.faults.markers import Dropout, Ghost, Noise, Occlusion, Swap
from simulators.faults.packets import Duplicate, Flip, Jitter, Loss, Reorder, Truncate
from simulators.faults.stamps import ClockJump, Drift

AnyFault = (
    Swap
    | Ghost
    | Noise
    | Dropout
    | Occlusion
    | Drift
    | ClockJump
    | Loss
    | Duplicate
    | Truncate
    | Flip
    | Jitter
    | Reorder
    | Stall
    | Unplug
)
KINDS = get_args(AnyFault)  # in the order in which they act


class FaultPlan(BaseModel):
    """What a fault file says."""

    model_config = ConfigDict(extra="forbid", strict=True)

    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    fault: list[Annotated[AnyFault, Field(discriminator="kind")]] = []


def read_plan(path: Path, labels: Sequence[str]) -> FaultPlan:
    """Reads a fault file for a device that sends the markers `labels`.

    Raises UsageError, which names file, line and key.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "it is no UTF-8 text"
        raise UsageError(f"cannot read the fault file {path}: {why}") from error
    return parse_plan(text, labels, str(path))


def parse_plan(text: str, labels: Sequence[str], name: str = "faults") -> FaultPlan:
    """Reads the text of a fault file, of that name. Raises UsageError."""
    try:
        return FaultPlan.model_validate(tomllib.loads(text), context={"labels": tuple(labels)})
    except tomllib.TOMLDecodeError as error:
        raise UsageError(f"{name}: {error}") from error
    except ValidationError as error:
        raise UsageError(_explained(error, text, name)) from error


def _explained(error: ValidationError, text: str, name: str) -> str:
    """The first of the errors, in a line."""
    first = error.errors()[0]
    path, model, owner = list(first["loc"]), FaultPlan, ""
    if len(path) > 1:  # fault, its number, its kind where that is known, and the key
        owner = f"fault {int(path[1]) + 1}: "
        if len(path) > 2:
            model = next(one for one in KINDS if _kind(one) == path[2])
            owner = f"fault {int(path[1]) + 1} ({path.pop(2)}): "
    lines = (line_of(text, tuple(path[:depth])) for depth in range(len(path), 0, -1))
    line = next((f", line {line}" for line in lines if line), "")
    key = ".".join(str(step) for step in (path[2:] if owner else path))
    return f"{name}{line}: {owner}{key and key + ': '}{_problem(first, model)}"


def _problem(error: ErrorDetails, model: type[BaseModel]) -> str:
    """What is wrong with a key of `model`, and what is known instead."""
    context = error.get("ctx", {})
    if error["type"] == "extra_forbidden":
        known = (field.alias or name for name, field in model.model_fields.items())
        return f"unknown key (known: {', '.join(known)})"
    if error["type"].startswith("union_tag"):
        kind = f"unknown kind '{context['tag']}'" if "tag" in context else "it names no kind"
        return f"{kind} (known: {', '.join(_kind(one) for one in KINDS)})"
    if error["type"] == "missing":
        return "it has to be there"
    return str(context.get("error", error["msg"]))


def _kind(fault: type[BaseModel]) -> str:
    return str(get_args(fault.model_fields["kind"].annotation)[0])
