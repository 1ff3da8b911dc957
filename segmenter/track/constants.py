"""Constants of tracks: what they are, what they were set by, and what moving them does.

Chosen by hand where no source is named, and kept because the fixed suite of simulated belts passed with them
(docs/evaluation-segmentation.md; its seed 1101 served for tuning). The count rule's limits stand in `CountSettings`,
the tracker's in `TrackSettings`. Constants inside compiled kernels stay in the kernel's own file: numba's cache notices
changes of that file only.
"""

from __future__ import annotations

# Travel estimated from the load (`travel`)
LEAST_CELLS = 40
"""Occupied cells of 4 mm, 6 cm2. Less load tells no shift."""
LEAST_COMMON = 12
"""Occupied cells in the overlap of two frames. Fewer match by chance."""
LEAST_MATCH = 0.35
"""Normalised correlation below which a shift is not believed, and the last speed carries on. Lower believes chance."""
SURE_MATCH = 0.8
"""Normalised correlation that two frames reach which show the same load. Where the last speed says that they share no
belt, only this shows that the belt stood still, or that the clock ran without it."""
FIRST_MATCH = 0.62
FIRST_WITHIN_S = 0.3
"""Normalised correlation below which no shift is believed between frames further apart than so many seconds, before
any speed is known: they may share no belt. On belts of three kinds those that share some reached 0.64 to 0.88, the
others 0.57 at most. Lower: of a belt of which every 18th frame was processed, a sixth was told, and 100 % of it seen.
"""
LEAST_OVERLAP = 0.2
"""Share of the view that two frames must share: what lies between them is told by the speed alone."""
FAR_COST = 0.3
FAR_M = 0.15
"""Correlation that a shift loses which is `FAR_M` metres or more off the expected one, less where it is nearer. Tubers
in rows match one another's places too; more holds on to an old speed when the belt stops."""
SPEEDS_KEPT = 15
"""Frames whose median is the speed: half a second. More is steadier, and slower to see a stop."""
SPEEDS_TO_LOOK_BACK = 5
"""Speeds known before the belt that ran on unseen is added, once."""
BACK_MPS = 1.0
BACK_SPEEDS = 3.0
BACK_LEAST_M = 0.03
"""Against its way, metres per second (and so many times its speed, and metres), that no belt runs from one frame to the
next: the pictures are out of order. Less takes a belt for torn that is turned back; more counts tubers as never there,
on belt that it calls seen.
"""
TALLEST_M = 0.08
"""Metres. Only the belt on which even the tallest load is in the picture is compared: the border stands still."""
MAX_SPEED_MPS = 3.0
"""Metres per second; ten times a harvester's belt."""
BELIEVED_BACK_M = 0.5
"""An encoder that comes back farther behind the load than this counts from another zero: the places that it told would
be those of belt that is counted already. Load is followed to 1 %, so this is 50 m without an encoder."""

# One track (`track`, `tracker`)
TRUST_CAP = 8.0
"""Readings. Older ones fade, so that a tuber may roll a little; more is steadier on belts where none does."""
CUT_TRUST = 0.02
ODD_TRUST = 0.15
"""Readings that one counts for which is cut by the first or last row, or odd, or of a part: its centre says little."""
ODD_AREA = 1.35
"""A visible area that changed by more than this factor since is a merge or a split: its centre says little."""
VACANT_GONE = 12
"""Frames of moving belt that show bare belt at its place: it fell or was taken off."""
SWALLOWED = 2.5
"""So many times the area of a track has the instance that it is one with, where it is a fragment of that one."""
STEADY_TRUST = 3
"""Readings behind a place that may correct the estimated travel."""

# The count rule (`counting`, `coverage`)
NEAR_ROW_M = 0.06
"""Metres around the centre row whose readings tell the crossing: what a tuber did at the rims matters less."""
VANISHED_FRAMES = 4
"""Frames of bare belt at its place before the row: it is gone, not hidden."""
ROUND_FILL = 0.7
"""Mean over highest height of a lying tuber. The mean is the safer one: a seam lends its height to a few cells only."""
LONGEST_TUBER_M = 0.12
"""Metres; of the view so much is needed to see a tuber whole, the rest may pass between two frames."""
USUAL_TUBER_M = 0.08
"""Metres; so long a tuber must be whole beyond the centre row for the belt there to count as seen after a restart."""

# Views (`views`)
KEPT_PER_SLOT = 3
"""Candidates kept per wanted position; the choice falls when the track's usual area is known."""
NEAR_M = 0.025
"""Metres. Within this of its wanted position every view is a candidate; farther off, only one this much nearer."""
PASSED_M = 0.004
"""Metres past its wanted position from which on a view is settled: places still move by that much."""
SETTLED_M = 0.015
"""Metres before a track is decided at which its last view is wanted: a frame at 0.2 m/s and 15 a second."""
LEAST_HEIGHT_M = 0.004
"""Metres. Pixels of a crop lower than this are belt at the rim of the mask; higher trims tubers."""
ODD_COST_M = 0.2
ODD_FREE = 0.05
"""Metres that a view loses per unit of log area off the track's usual one, beyond `ODD_FREE`."""

# Travel history (`history`)
KEPT_FRAMES = 4096
"""Frames, two minutes at 30 a second: a bound on memory."""
STILL_M = 0.001
"""Metres. A belt that moved less stands still, and its frames count once."""
