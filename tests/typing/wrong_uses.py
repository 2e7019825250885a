"""Wrong uses, which a type checker must report on exactly the lines that end in ``# wrong``."""

from __future__ import annotations

import numpy as np

import loi
from loi.renderers import Disks

REFERENCE = np.zeros((8, 8, 3))
DISKS = Disks(8, 8, [[4.0, 4.0]], 2.0, [[1.0, 1.0, 1.0]])
OBJECTIVE = loi.LOIObjective(REFERENCE)

loi.LOIObjective(REFERENCE, "for_image")  # wrong
loi.LOIObjective(REFERENCE, accuracy=None)  # wrong
loi.LOIObjective(REFERENCE, nan_policy="ignore")  # wrong
loi.LOIObjective(REFERENCE, None, "exact", -1)  # wrong
loi.LOIObjective()  # wrong
loi.ScaleSpace(1, (3, 9))  # wrong
loi.ScaleSpace(1, (3, 9), 0.1, boundary="wrap")  # wrong
loi.ScaleSpace.paper("mesh")  # wrong
loi.GaussianPyramid(REFERENCE, levels="all")  # wrong
loi.Free(0.0, 0.0, 1.0, learning_rate=[1.0])  # wrong
loi.fit(DISKS)  # wrong
loi.fit(DISKS, OBJECTIVE, steps="many")  # wrong
loi.fit(DISKS, OBJECTIVE, decay="linear")  # wrong
loi.fit(DISKS, OBJECTIVE, callback=lambda step: None)  # wrong
loi.fit(object(), OBJECTIVE)  # wrong
loi.fit(DISKS, object())  # wrong
loi.fit(DISKS, OBJECTIVE).best  # wrong
loi.fit(DISKS, OBJECTIVE).best_value.upper()  # wrong
loi.fit(DISKS, OBJECTIVE).diagnosis.ok  # wrong
loi.read_target("photo.png", to="Lab")  # wrong
loi.not_there  # wrong
OBJECTIVE.plan("wide")  # wrong
text: str = OBJECTIVE.tolerance  # wrong
