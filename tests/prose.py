"""Measure the prose and the names of the repository: ``python -m tests.prose [PATH ...]``, part of ``make lint``.

Two figures for each folder. The *dialect* rate counts constructions that technical English hardly uses, per 1,000
words of docstrings, comments and Markdown paragraphs. The *vague* share is the percentage of bound names without a noun
in them, such as ``found`` or ``other``. SciPy, optax and array-api-extra stand at 0.9 to 1.5 per 1,000 and 0.1 to 1 %.
Mend a sentence by naming its subject, never by replacing one listed word with another. Names of tests are checked as
well: each has a subject, a length that fits a line, and no namesake.
"""

from __future__ import annotations

import argparse
import ast
import io
import re
import subprocess
import sys
import tokenize
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

MAX_DIALECT_PER_1000_WORDS: Final = 3.0
MAX_VAGUE_PERCENT: Final = 2.0
MIN_HITS: Final = 2  # a folder of a few words may hold one such construction
MAX_TEST_NAME_CHARACTERS: Final = 88

_NOUN_CLAUSE_VERBS: Final = (
    "is are was has have had move moves it they we lies comes there hides one a an the each all nobody no of can does "
    "do goes stands bends another other others cast casts throw throws follow follows count counts shadows light"
)
_RELATIVE_PREPOSITIONS: Final = "of in at by from to on for over under along through with"
_FRONTED_NOUNS: Final = "a an the what some each two several those such these all this other ten"
_TOLD_OBJECTS: Final = "apart from of by when it what which whether beforehand a the how nothing"


def _any_of(words: str) -> str:
    return "(?:" + "|".join(words.split()) + ")"


DIALECT: Final[dict[str, re.Pattern[str]]] = {
    advice: re.compile(pattern, re.MULTILINE)
    for advice, pattern in {
        "name the thing instead of 'what ...'": rf"\b[Ww]hat {_any_of(_NOUN_CLAUSE_VERBS)}\b",
        "repeat the noun instead of 'that of'": r"\b(?:that|those) of\b",
        "say 'shows', 'reports' or 'distinguishes' instead of 'tells'": (
            rf"\btold\b|\btells? {_any_of(_TOLD_OBJECTS)}\b"
        ),
        "name the agent instead of 'by what' or 'by hand'": rf"\bby {_any_of('what whatever which whoever hand')}\b",
        "use the genitive instead of a fronted 'Of ...'": rf"(?:^|[.;:] )Of {_any_of(_FRONTED_NOUNS)}\b",
        "repeat the verb instead of 'so it is'": r"\b(?:so it is|so do|so is|so are|and so)\b",
        "say how it differs instead of 'is otherwise'": r"\b(?:is|are) otherwise\b|\botherwise than\b",
        "split the sentence instead of 'of which'": rf"\b{_any_of(_RELATIVE_PREPOSITIONS)} which\b",
        "use 'ensure' instead of 'see to'": r"\bsee[sn]? to\b",
        "name the object instead of 'has it'": rf"\b(?:has|have) {_any_of('it them none those that')}\b",
        "begin a new sentence instead of 'nor has'": rf"\b[Nn]or {_any_of('have has is does do are at for what')}\b",
        "name the state instead of 'once that'": rf"\b{_any_of('once where while as if')} that\b",
    }.items()
}
"""Constructions to avoid, by the advice that mends them."""

_VAGUE_WORDS: Final = """
    across after again
    ahead alike along apart around asked away back before behind beside both drawn each end ends every
    far found given
    here high kept kind known least less low made met more most near one other others ours own part parts
    place places rest seen side sides theirs there told turn turned wanted way within without
"""
VAGUE_NAMES: Final = frozenset(_VAGUE_WORDS.split())
"""Identifiers that name no value."""


@dataclass
class Tally:
    """Counts of one folder."""

    words: int = 0
    names: int = 0
    dialect: list[str] = field(default_factory=list)
    vague: list[str] = field(default_factory=list)

    @property
    def dialect_rate(self) -> float:
        """Constructions per 1,000 words."""
        return 1000.0 * len(self.dialect) / max(self.words, 1)

    @property
    def vague_percent(self) -> float:
        """Vague names as a percentage of all bound names."""
        return 100.0 * len(self.vague) / max(self.names, 1)

    @property
    def fails(self) -> bool:
        """Whether a figure exceeds its limit."""
        return (len(self.dialect) >= MIN_HITS and self.dialect_rate > MAX_DIALECT_PER_1000_WORDS) or (
            len(self.vague) >= MIN_HITS and self.vague_percent > MAX_VAGUE_PERCENT
        )


def markdown_paragraphs(text: str) -> Iterator[tuple[int, str]]:
    """Yield the lines of a page outside fenced blocks and tables, with their numbers."""
    is_fenced = False
    for number, line in enumerate(text.splitlines(), 1):
        if line.lstrip().startswith("```"):
            is_fenced = not is_fenced
        elif not is_fenced and not line.startswith("|"):
            yield number, line


def python_prose(text: str) -> Iterator[tuple[int, str]]:
    """Yield the docstrings and comments of a module, with their first lines."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            docstring = ast.get_docstring(node)
            if docstring:
                yield node.body[0].lineno, docstring
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        comment = token.string.lstrip("# ")
        if token.type == tokenize.COMMENT and not comment.startswith(
            ("noqa", "type:", "fmt", "ruff", "pyright", "isort")
        ):
            yield token.start[0], comment


def bound_names(text: str) -> Iterator[tuple[int, str]]:
    """Yield the variables and arguments that a module binds, with their lines."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.id
        elif isinstance(node, ast.arg):
            yield node.lineno, node.arg


def measure(path: str, text: str, tally: Tally) -> None:
    """Add the prose and the names of one file to a tally."""
    is_python = path.endswith(".py")
    for number, prose in python_prose(text) if is_python else markdown_paragraphs(text):
        tally.words += len(re.findall(r"[A-Za-z']+", prose))
        for advice, pattern in DIALECT.items():
            tally.dialect.extend(f"{path}:{number}: '{hit[0].strip()}': {advice}" for hit in pattern.finditer(prose))
    for number, name in bound_names(text) if is_python else ():
        tally.names += 1
        if name.strip("_").lower() in VAGUE_NAMES:
            tally.vague.append(f"{path}:{number}: name the value instead of `{name}`")


def test_name_faults(modules: Mapping[str, str]) -> list[str]:
    """Return a line for every name of a test without a subject, over-long, or used before, of modules by path."""
    first_uses: dict[str, str] = {}
    faults = []
    for path, text in modules.items():
        for node in ast.walk(ast.parse(text)):
            if not isinstance(node, ast.FunctionDef) or not node.name.startswith("test_"):
                continue
            location = f"{path}:{node.lineno}"
            words = node.name.split("_")
            if words[1] == "it":
                faults.append(f"{location}: name the subject instead of 'it': {node.name}")
            if len(node.name) > MAX_TEST_NAME_CHARACTERS:
                faults.append(f"{location}: {len(node.name)} characters, of {MAX_TEST_NAME_CHARACTERS}: {node.name}")
            if first_uses.setdefault(node.name, location) != location:
                faults.append(f"{location}: {node.name} is also at {first_uses[node.name]}")
    return faults


def folder_of(path: Path) -> str:
    """Return the folder that a file counts in: two levels deep, three below ``adapters``."""
    depth = 3 if path.parts[0] == "adapters" else 2
    return "/".join(path.parts[: min(depth, len(path.parts) - 1)]) or path.name


def main(arguments: Sequence[str]) -> int:
    """Print a line for each folder, and every hit of those that fail; return the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("paths", nargs="*", default=["."])
    parser.add_argument("--all", action="store_true", help="list the hits of every folder")
    options = parser.parse_args(arguments)
    listed = subprocess.run(["git", "ls-files", *options.paths], capture_output=True, text=True, check=True)  # noqa: S607
    paths = [Path(name) for name in sorted(listed.stdout.split())]
    texts = {path: path.read_text(encoding="utf8") for path in paths if path.suffix in (".py", ".md") and path.exists()}
    tallies: dict[str, Tally] = {}
    for path, text in texts.items():
        measure(str(path), text, tallies.setdefault(folder_of(path), Tally()))
    print(f"{'':32}{'words':>8}{'dialect/1000':>14}{'names':>8}{'vague %':>9}")
    for folder, tally in sorted(tallies.items()):
        mark = "  <-- over the limit" if tally.fails else ""
        print(f"{folder:32}{tally.words:8}{tally.dialect_rate:14.1f}{tally.names:8}{tally.vague_percent:9.1f}{mark}")
    failing = [tally for tally in tallies.values() if tally.fails]
    for tally in tallies.values() if options.all else failing:
        print(*tally.dialect, *tally.vague, sep="\n")
    faults = test_name_faults({str(path): text for path, text in texts.items() if path.name.startswith("test_")})
    print(*faults, sep="\n")
    return 1 if failing or faults else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
