"""Sets Mitsuba's variant. The llvm variants need the shared library of LLVM 17 or newer, which is looked for."""

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
    """The newest library, or None; what the variable names goes first. Of use before Dr.Jit first looks."""
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


def set_variant(variant):
    """`mi.set_variant`, with LLVM where one is found; `RuntimeError` says in one line what is missing."""
    import mitsuba as mi

    llvm = variant.startswith("llvm")
    if llvm:
        find()
    try:
        mi.set_variant(variant)
    except ImportError as problem:
        raise RuntimeError(ADVICE if llvm and variant in mi.variants() else str(problem).strip()) from problem


def one_line(problem):
    """What is wrong, without the trace that Mitsuba puts around an error in a plugin's constructor."""
    return str(problem).strip().splitlines()[-1].removeprefix("BundleError: ").removeprefix("neumip: ")
