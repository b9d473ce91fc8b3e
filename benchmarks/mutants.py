"""
Change the numerical core in one small place at a time, and count the changes that a test notices.

The mutants live in memory alone: a process with numpy and pytest loaded forks, its child imports
the changed module in place of the file, runs the target's tests up to the first failure and
leaves. Nothing on disk changes. A mutant that takes many times as long as the tests do counts as
killed. Needs a system that forks.

    python benchmarks/mutants.py --target laws
"""

from __future__ import annotations

import argparse
import ast
import importlib.util
import math
import os
import random
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, SourceFileLoader
from pathlib import Path
from types import CodeType
from typing import Any, NamedTuple

import hypothesis
import numpy.testing
import PIL.Image
import pytest
import scipy.special
import scipy.stats

ROOT = Path(__file__).resolve().parents[1]
# Loaded before the fork, so that no child has to load them; and never the library itself.
LOADED = (numpy.testing, PIL.Image, scipy.special, scipy.stats)
# The fast tests that are to kill the mutants of a module, beside its doctests.
TARGETS = {
    "laws": ["laws_of_depth"],
    "core.closed_form": ["closed_form"],
    "core.estimator": ["estimator", "core_mutants"],
    "core.blocks": ["estimator", "core_mutants"],
    "core.posterior": ["posterior"],
    "sampling": ["sampling"],
}
PATIENCE_S, PATIENCE = 5.0, 4.0  # a mutant may take so long, and so many times what the tests do
Z95 = 1.96
OPTIONS = [
    "-x",
    "-q",
    "--tb=no",
    "--disable-warnings",
    "-p",
    "no:cacheprovider",
    "-m",
    "not slow",
    "-W",
    "ignore::pytest.PytestAssertRewriteWarning",  # hypothesis is loaded before the fork
]

# What replaces what. Names are functions, of numpy or of Python.
OPERATORS: dict[type[ast.AST], tuple[type[ast.AST], ...]] = {
    ast.Add: (ast.Sub,),
    ast.Sub: (ast.Add,),
    ast.Mult: (ast.Div,),
    ast.Div: (ast.Mult,),
    ast.FloorDiv: (ast.Mult,),
    ast.Mod: (ast.Mult,),
    ast.Pow: (ast.Mult,),
    ast.BitAnd: (ast.BitOr,),
    ast.BitOr: (ast.BitAnd,),
    ast.And: (ast.Or,),
    ast.Or: (ast.And,),
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
}
_PAIRS = (
    ("minimum", "maximum"),
    ("min", "max"),
    ("any", "all"),
    ("ceil", "floor"),
    ("argmin", "argmax"),
    ("exp", "log"),
    ("zeros", "ones"),
    ("zeros_like", "ones_like"),
    ("isfinite", "isnan"),
    ("add", "subtract"),
    ("multiply", "divide"),
    ("left", "right"),
)
NAMES = {a: b for pair in _PAIRS for a, b in (pair, pair[::-1])} | {"sqrt": "square", "abs": "sign"}
REVERSED = (ast.Compare, ast.UnaryOp)  # these have their own mutants, which reverse them


class Mutant(NamedTuple):
    """One change: where it is, what it does, and the whole module with it."""

    line: int
    change: str
    code: CodeType


def changes(node: ast.AST) -> Iterator[ast.AST]:
    """List what a node may become."""
    match node:
        case ast.BinOp(op=op) | ast.BoolOp(op=op) | ast.AugAssign(op=op):
            yield from (_with(node, op=other()) for other in OPERATORS.get(type(op), ()))
        case ast.Compare(ops=[op]):
            yield from (_with(node, ops=[other()]) for other in OPERATORS.get(type(op), ()))
        case ast.UnaryOp(operand=operand):
            yield operand
        case ast.Constant(value=value):
            yield from (ast.Constant(other) for other in _values(value))
        case ast.Attribute(attr=name) if name in NAMES:
            yield _with(node, attr=NAMES[name])
        case ast.Name(id=name) if name in NAMES:
            yield _with(node, id=NAMES[name])
        case ast.Call(func=ast.Attribute(attr="where"), args=[condition, yes, no]):
            yield _with(node, args=[condition, no, yes])
        case ast.If(test=test) | ast.IfExp(test=test) if not isinstance(test, REVERSED):
            yield _with(node, test=ast.UnaryOp(ast.Not(), test))
    if isinstance(node, ast.Break | ast.AugAssign) or _is_effect(node):
        yield ast.Pass()


def _values(value: object) -> tuple[object, ...]:
    """List what a constant may become."""
    match value:
        case bool():
            return (not value,)
        case int():
            return value + 1, value - 1
        case float():
            return (2 * value if value else 1.0,)
        case "left" | "right":
            return (NAMES[value],)
    return ()


def _with(node: ast.AST, **fields: Any) -> ast.AST:
    old = {name: getattr(node, name) for name in node._fields}
    return type(node)(**{**old, **fields})


def _is_effect(node: ast.AST) -> bool:
    """Tell whether the module would still run without this statement."""
    match node:
        case ast.Expr(value=value):
            return not isinstance(value, ast.Constant | ast.Yield)
        case ast.Assign(targets=[target]):
            return isinstance(target, ast.Subscript)
    return False


def places(node: ast.AST) -> Iterator[tuple[ast.AST, ast.AST, Callable[[ast.AST], None]]]:
    """List every node that computes: its statement or itself, itself, and how to replace it."""
    for name, value in ast.iter_fields(node):
        if name in {"annotation", "returns", "decorator_list", "bases", "type_params"}:
            continue
        if isinstance(value, ast.AST):
            yield node, value, lambda new, name=name: setattr(node, name, new)
            yield from places(value)
        elif isinstance(value, list):
            for index, item in enumerate(value):
                if isinstance(item, ast.AST):
                    yield node, item, lambda new, at=index, of=value: of.__setitem__(at, new)
                    yield from places(item)


def mutants(path: Path) -> list[Mutant]:
    """Make all mutants of a file."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    found: list[Mutant] = []
    for parent, node, put in list(places(tree)):
        for new in changes(node):
            shown = parent if isinstance(parent, ast.expr | ast.keyword) else node
            before = _first_line(shown)
            ast.copy_location(new, node)
            put(new)
            after = _first_line(new if shown is node else shown)
            code = compile(ast.fix_missing_locations(tree), str(path), "exec")
            put(node)
            found.append(Mutant(node.lineno, f"`{before}` -> `{after}`", code))
    return found


def _first_line(node: ast.AST) -> str:
    text = ast.unparse(node).splitlines()[0]
    return text if len(text) <= 70 else text[:67] + "..."


class Changed(SourceFileLoader):
    """Load a module from other code than its file's."""

    def __init__(self, name: str, path: str, code: CodeType) -> None:
        super().__init__(name, path)
        self.code = code

    def get_code(self, _fullname: str) -> CodeType:
        """Give the changed code."""
        return self.code


class Finder(MetaPathFinder):
    """Find the changed module before its file."""

    def __init__(self, name: str, path: Path, code: CodeType) -> None:
        self.name, self.path, self.code = name, path, code

    def pytest_sessionstart(self) -> None:
        """Step before pytest's own finder, which would read the file."""
        sys.meta_path.insert(0, self)

    def find_spec(self, fullname: str, *_: object) -> ModuleSpec | None:
        """Find the one module."""
        if fullname != self.name:
            return None
        loader = Changed(fullname, str(self.path), self.code)
        return importlib.util.spec_from_file_location(fullname, self.path, loader=loader)


def passing(
    target: str, path: Path, codes: list[CodeType], workers: int, limit_s: float = math.inf
) -> Iterator[int]:
    """Run a target's tests with each code, some at a time, and list where all pass."""
    running: dict[int, tuple[int, float]] = {}  # which, and when it began
    todo = iter(range(len(codes)))
    while True:
        while len(running) < workers and (which := next(todo, None)) is not None:
            child = os.fork()
            if child == 0:
                _test(target, path, codes[which])
            running[child] = which, time.monotonic()
        if not running:
            return
        done, status = os.waitpid(-1, os.WNOHANG)
        if done:
            which, _ = running.pop(done)
            if status == 0:
                yield which
            continue
        for child, (_, start) in running.items():
            if time.monotonic() - start > limit_s:
                os.kill(child, signal.SIGKILL)
        time.sleep(0.01)


def _test(target: str, path: Path, code: CodeType) -> None:
    """Run a target's tests in this process, and end it."""
    status = 1
    try:
        quiet = os.open(os.devnull, os.O_WRONLY)
        os.dup2(quiet, 1)
        os.dup2(quiet, 2)
        finder = Finder(f"imgscale.{target}", path, code)
        tests = [f"tests/test_{name}.py" for name in TARGETS[target]]
        status = pytest.main([str(path), *tests, *OPTIONS], plugins=[finder])
    finally:
        os._exit(int(status))


def interval(share: float, n: int) -> tuple[float, float]:
    """Compute Wilson's 95 % interval of a share of n."""
    middle = (share + Z95**2 / (2 * n)) / (1 + Z95**2 / n)
    half = Z95 / (1 + Z95**2 / n) * math.sqrt(share * (1 - share) / n + Z95**2 / (4 * n**2))
    return middle - half, middle + half


def report(target: str, sample: int | None, seed: int, workers: int, lines: set[int]) -> str:
    """Print the survivors, and give a row of the table."""
    path = ROOT / "src" / "imgscale" / (target.replace(".", "/") + ".py")
    every = mutants(path)
    chosen = [mutant for mutant in every if not lines or mutant.line in lines]
    if sample is not None and sample < len(chosen):
        chosen = random.Random(seed).sample(chosen, sample)  # noqa: S311 - no secret
    unchanged = compile(path.read_text(encoding="utf-8"), str(path), "exec")
    start = time.monotonic()
    if not list(passing(target, path, [unchanged], 1)):
        sys.exit(f"The tests of {target} fail without any change; mend them first.")
    limit_s = PATIENCE_S + PATIENCE * (time.monotonic() - start)
    left = 0
    for which in passing(target, path, [mutant.code for mutant in chosen], workers, limit_s):
        left += 1
        print(f"{path.name}:{chosen[which].line}: {chosen[which].change}", flush=True)
    n, killed = len(chosen), len(chosen) - left
    low, high = interval(killed / n, n)
    extent = "" if n == len(every) else f" (95 % interval {low:.0%} to {high:.0%})"
    return f"| {target} | {len(every)} | {n} | {killed} | {killed / n:.1%}{extent} |"


def main() -> None:
    """Print the table of the targets, and the survivors."""
    parser = argparse.ArgumentParser(description="Mutation testing of the numerical core.")
    parser.add_argument("--target", choices=[*TARGETS, "all"], default="all")
    parser.add_argument("--sample", type=int, help="try so many mutants of each, drawn at random")
    parser.add_argument("--seed", type=int, default=0, help="of the drawing")
    parser.add_argument("--workers", type=int, default=2, help="processes at a time")
    parser.add_argument("--lines", type=int, nargs="*", default=[], help="only these lines")
    options = parser.parse_args()
    os.chdir(ROOT)
    hypothesis.settings.register_profile(
        "mutants",
        database=None,
        derandomize=True,
        deadline=None,
        phases=(hypothesis.Phase.explicit, hypothesis.Phase.generate),
    )
    hypothesis.settings.load_profile("mutants")
    with tempfile.TemporaryDirectory() as cache:
        sys.pycache_prefix, sys.dont_write_bytecode = cache, False
        os.environ["HYPOTHESIS_STORAGE_DIRECTORY"] = cache
        rows = [
            report(target, options.sample, options.seed, options.workers, set(options.lines))
            for target in (TARGETS if options.target == "all" else [options.target])
        ]
    print(
        "| module | mutants | tried | killed | share |", "| --- | --- | --- | --- | --- |", sep="\n"
    )
    print(*rows, sep="\n")


if __name__ == "__main__":
    main()
