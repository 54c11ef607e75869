"""Finds what Mitsuba's llvm variants need: the shared library of LLVM 17 or newer."""

import glob
import os
import re

VARIABLE = "DRJIT_LIBLLVM_PATH"
OLDEST = 17
PLACES = [
    "/usr/lib/*/libLLVM*.so*",
    "/usr/lib/libLLVM*.so*",
    "/usr/lib64/libLLVM*.so*",
    "/usr/lib/llvm-*/lib/libLLVM*.so*",
    "/opt/homebrew/opt/llvm*/lib/libLLVM*.dylib",
    "/usr/local/opt/llvm*/lib/libLLVM*.dylib",
]
ADVICE = f"LLVM {OLDEST} or newer was not found: install it (Debian: libllvm19) or name its library in {VARIABLE}"


def find():
    """The newest library, or None; what the variable names goes first. Call it before Dr.Jit is first used."""
    if os.environ.get(VARIABLE):
        return os.environ[VARIABLE]
    found = []
    for path in (path for place in PLACES for path in glob.glob(place)):
        numbers = re.findall(r"\d+", os.path.basename(path)) or re.findall(r"llvm-(\d+)", path)
        if numbers and int(numbers[0]) >= OLDEST:
            found.append((int(numbers[0]), path))
    if not found:
        return None
    os.environ[VARIABLE] = max(found)[1]
    return os.environ[VARIABLE]


def prepare(variant):
    """Makes `mi.set_variant(variant)` work, or raises with what is missing."""
    if variant.startswith("llvm") and find() is None:
        raise RuntimeError(ADVICE)
