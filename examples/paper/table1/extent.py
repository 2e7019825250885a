"""The extent of Table 1 to carry out: its subtables, their rows and columns, and the runs of each."""

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

__all__ = ["ABLATED", "ABLATION_SEEDS", "SEEDS", "SUBTABLES", "Extent"]

SEEDS: Final = 10
ABLATION_SEEDS: Final = 3
ABLATED: Final = (COLUMNS[3], COLUMNS[4], HARDER[2])
SUBTABLES: Final = ("tuning", "ours", "published", "harder", "remedies", "ablations")


@dataclass(frozen=True)
class Extent:
    """Extent of the table to carry out.

    Attributes
    ----------
    names : tuple of str
        Subtables, among `SUBTABLES`.
    methods : tuple of str
        Methods, in the order of the table.
    columns, harder, ablated : tuple of Column
        Columns of the paper's table, the harder columns, and the columns of the ablations.
    seeds : int
        Number of starts.
    ablation_seeds : int
        Number of starts for ablations, and for remedies outside `CHECKED`.
    steps : int, optional
        Steps of every fit, in place of the steps of its setting; the search keeps its own.
    """

    names: tuple[str, ...]
    methods: tuple[Method, ...]
    columns: tuple[Column, ...] = COLUMNS
    harder: tuple[Column, ...] = HARDER
    ablated: tuple[Column, ...] = ABLATED
    seeds: int = SEEDS
    ablation_seeds: int = ABLATION_SEEDS
    steps: int | None = None

    @property
    def tables(self) -> dict[str, Subtable[Run]]:
        """Subtables by name; the remedies have one subtable for each column."""
        tables: dict[str, Subtable[Run]] = {}
        for name in self.names:
            if name == "remedies":
                tables |= {f"remedies: {column.name}": self._remedies(column) for column in self.harder}
            else:
                tables[name] = self._subtable(name)
        return tables

    @property
    def runs(self) -> list[Run]:
        """All runs of all subtables, without duplicates."""
        return list(dict.fromkeys(run for subtable in self.tables.values() for run in subtable.runs))

    def _remedies(self, column: Column) -> Subtable[Run]:
        rows = {}
        for setting in REMEDIES[column]:
            seeds = self.seeds if (column, setting) in CHECKED else self.ablation_seeds
            rows[setting.name] = [self._run(setting, column, seed) for seed in range(seeds)]
        return Subtable(rows, (column,), converges=False)

    def _subtable(self, name: str) -> Subtable[Run]:
        if name == "tuning":
            return Subtable({LABELS[method]: tuning_runs(method) for method in self.methods}, rates=RATES)
        if name == "ablations":
            settings = {setting.name: setting for setting in ABLATIONS}
            columns, seeds = self.ablated, self.ablation_seeds
        else:
            protocol, columns = ("ours", self.harder) if name == "harder" else (name, self.columns)
            settings, seeds = {LABELS[method]: PROTOCOLS[protocol][method] for method in self.methods}, self.seeds
        rows = {
            row: [self._run(setting, column, seed) for column in columns for seed in range(seeds)]
            for row, setting in settings.items()
        }
        return Subtable(rows, columns, converges=name != "ablations")

    def _run(self, setting: Setting, column: Column, seed: int) -> Run:
        return Run(setting if self.steps is None else setting.limited(self.steps), column, seed)
