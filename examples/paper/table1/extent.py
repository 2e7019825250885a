"""How much of the table is wanted: its parts, their rows and columns, and the runs of each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from examples.paper.lib.study import Subtable
from examples.paper.table1.ablations import ABLATIONS
from examples.paper.table1.problem import COLUMNS, HARDER, Column
from examples.paper.table1.remedies import CHECKED, REMEDIES
from examples.paper.table1.run import Run
from examples.paper.table1.settings import LABELS, PROTOCOLS, Method, Setting
from examples.paper.table1.tuning import RATES, tuning_runs

__all__ = ["ABLATED", "FEW", "PARTS", "SEEDS", "Extent"]

SEEDS: Final = 10
FEW: Final = 3
ABLATED: Final = (COLUMNS[3], COLUMNS[4], HARDER[2])
PARTS: Final = ("tuning", "ours", "published", "harder", "remedies", "ablations")


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
        How many starts; the second of ablations, and of remedies but those in `CHECKED`.
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
    def tables(self) -> dict[str, Subtable[Run]]:
        """What stands in each table, by its name: one for each part, but for the remedies one for each column."""
        found: dict[str, Subtable[Run]] = {}
        for name in self.parts:
            if name == "remedies":
                found |= {f"remedies: {column.name}": self._remedies(column) for column in self.harder}
            else:
                found[name] = self._whole(name)
        return found

    @property
    def runs(self) -> list[Run]:
        """All runs of all tables, each once."""
        return list(dict.fromkeys(run for part in self.tables.values() for run in part.runs))

    def _remedies(self, column: Column) -> Subtable[Run]:
        starts = {one: self.seeds if (column, one) in CHECKED else self.few for one in REMEDIES[column]}
        return Subtable(
            {one.name: [self._run(one, column, seed) for seed in range(count)] for one, count in starts.items()},
            (column,),
            converges=False,
        )

    def _whole(self, name: str) -> Subtable[Run]:
        if name == "tuning":
            return Subtable({LABELS[method]: tuning_runs(method) for method in self.methods}, rates=RATES)
        if name == "ablations":
            settings, columns, seeds = {one.name: one for one in ABLATIONS}, self.ablated, self.few
        else:
            protocol, columns = ("ours", self.harder) if name == "harder" else (name, self.columns)
            settings, seeds = {LABELS[method]: PROTOCOLS[protocol][method] for method in self.methods}, self.seeds
        rows = {
            name: [self._run(setting, column, seed) for column in columns for seed in range(seeds)]
            for name, setting in settings.items()
        }
        return Subtable(rows, columns, converges=name != "ablations")

    def _run(self, setting: Setting, column: Column, seed: int) -> Run:
        return Run(setting if self.steps is None else setting.limited(self.steps), column, seed)
