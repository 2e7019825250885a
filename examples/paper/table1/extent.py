"""How much of the table is wanted: its parts, their rows and columns, and the runs of each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from examples.paper.table1.ablations import ABLATIONS
from examples.paper.table1.problem import COLUMNS, HARDER, Column
from examples.paper.table1.remedies import REMEDIES
from examples.paper.table1.run import Run
from examples.paper.table1.settings import LABELS, PROTOCOLS, Method, Setting
from examples.paper.table1.tuning import tuning_runs

__all__ = ["ABLATED", "FEW", "PARTS", "SEEDS", "Extent", "Part"]

SEEDS: Final = 10
FEW: Final = 3
ABLATED: Final = (COLUMNS[3], COLUMNS[4], HARDER[2])
PARTS: Final = ("tuning", "ours", "published", "harder", "remedies", "ablations")


@dataclass(frozen=True)
class Part:
    """Runs by the name of their row, and the columns over which a row goes; none for a search."""

    rows: Mapping[str, Sequence[Run]]
    columns: tuple[Column, ...]

    @property
    def runs(self) -> list[Run]:
        """All of them."""
        return [run for runs in self.rows.values() for run in runs]

    def at(self, column: Column) -> dict[str, list[Run]]:
        """Those of one column."""
        return {name: [run for run in runs if run.column == column] for name, runs in self.rows.items()}


@dataclass(frozen=True)
class Extent:
    """How much of the table is wanted.

    Attributes
    ----------
    parts : tuple of str
        Of `PARTS`.
    methods : tuple of str
        In the order of the table.
    columns, harder, ablated : tuple of Column
        Of the table, of the harder ones, and of the ablations.
    seeds, few : int
        How many starts; the second of remedies and ablations.
    steps : int, optional
        Of every fit, instead of each setting's own; not of the search.
    """

    parts: tuple[str, ...]
    methods: tuple[Method, ...]
    columns: tuple[Column, ...] = COLUMNS
    harder: tuple[Column, ...] = HARDER
    ablated: tuple[Column, ...] = ABLATED
    seeds: int = SEEDS
    few: int = FEW
    steps: int | None = None

    @property
    def tables(self) -> dict[str, Part]:
        """What stands in each table, by its name: one for each part, but for the remedies one for each column."""
        found = {}
        for name in self.parts:
            if name == "remedies":
                for column in self.harder:
                    settings = {one.name: one for one in REMEDIES[column]}
                    found[f"remedies: {column.name}"] = self._part(settings, (column,), self.few)
            else:
                found[name] = self._whole(name)
        return found

    @property
    def runs(self) -> list[Run]:
        """All runs of all tables, each once."""
        return list(dict.fromkeys(run for part in self.tables.values() for run in part.runs))

    def _whole(self, name: str) -> Part:
        if name == "tuning":
            return Part({LABELS[method]: tuning_runs(method) for method in self.methods}, ())
        if name == "ablations":
            return self._part({one.name: one for one in ABLATIONS}, self.ablated, self.few)
        protocol, columns = ("ours", self.harder) if name == "harder" else (name, self.columns)
        settings = {LABELS[method]: PROTOCOLS[protocol][method] for method in self.methods}
        return self._part(settings, columns, self.seeds)

    def _part(self, settings: Mapping[str, Setting], columns: tuple[Column, ...], seeds: int) -> Part:
        steps = self.steps
        rows = {
            name: [
                Run(setting if steps is None else setting.limited(steps), column, seed)
                for column in columns
                for seed in range(seeds)
            ]
            for name, setting in settings.items()
        }
        return Part(rows, columns)
