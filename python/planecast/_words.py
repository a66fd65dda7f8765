"""Keyword arguments as the words of a command."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy


def text(name: str, value: Any) -> str:
    """One value as the command line has it."""
    if isinstance(value, str):
        return value
    if isinstance(value, (os.PathLike, bytes)):
        return os.fsdecode(value)
    if isinstance(value, range):
        if value.step != 1:
            raise ValueError(f"{name}=: {value!r}; a range of frames has steps of 1")
        return f"{value.start}..{value.stop}"
    if isinstance(value, (Sequence, numpy.ndarray)):
        if name == "frames" and len(value) == 2 and isinstance(value[0], range):
            return f"{text(name, value[0])}/{text(name, value[1])}"
        between = "x" if name in ("size", "window") else ","
        return between.join(text("", v) for v in value)
    if isinstance(value, (bool, numpy.bool_)):
        raise ValueError(f"{name}=: {value!r}; it is a number or a word")
    if isinstance(value, (int, numpy.integer)):
        return str(int(value))
    if isinstance(value, (float, numpy.floating)):
        return repr(float(value))
    raise ValueError(f"{name}=: cannot take {type(value).__name__}; expected a number, a word or several of them")


def words(arguments: Mapping[str, Any]) -> list[str]:
    """Keyword arguments as the words of a command; None and False stand for what is not said."""
    out = []
    for name, value in arguments.items():
        flag = "--" + name.replace("_", "-")
        if value is True:
            out.append(flag)
        elif value is not None and value is not False:
            out.append(f"{flag}={text(name, value)}")
    return out
