"""Constants of one frame: what they are, what they were set by, and what moving them does.

"Suite" is the fixed suite of simulated belts in docs/evaluation-segmentation.md; its seed 1101 served for tuning. Where
no source is named, a value was chosen by hand and kept because the suite passed with it. Lengths of the splitter stand
in `SplitSettings` and `SeamSettings`. Constants inside compiled kernels stay in the kernel's own file:
numba's cache notices changes of that file only.
"""

from __future__ import annotations

from conveyor.belt_findings import LEANS_DEG, OFF_MM

# Frames that cannot be used (`gate`)
LEAST_SEEN_OF_FRAME = 0.1
"""Share of the image with depth; a covered lens has next to none. Higher drops frames that could still be used."""
FROZEN_M = 0.001
"""Metres of travel. A shorter way need not change a single pixel; longer notices a frozen camera later."""
STOOD_TOLD = 10
"""Frames in a row that are one picture from which on it is said, where no encoder tells whether the belt ran on. Of a
belt that stands a real camera takes no picture twice, bit for bit; a simulated one without noise does."""
HOLE_PX, HOLE_SEEN, LOOK_EVERY = 16, 0.125, 10
"""Pixels of a side of the squares that the picture is looked at in, share of a square with depth below which it shows
none, and frames between two looks. Of smaller squares a shadow at an outline fills many."""
HOLES_TOLD = 0.2
"""Share of the squares without depth from which on it is said. On simulated crowded belts of `harsh` it is 0.07 at
most, with dirt and more holes 0.10; loads before a lens with spots read 7 % light at 0.07, 26 % at 0.28, 95 % at 0.56,
and 52 % where half of the picture is dark."""
SAME_POSE = 0.02
"""Metres and sines by which entries of `belt_from_camera` may differ within a run: 20 mm, 1 degree. Two cameras of one
belt hang farther apart. Higher places a moved camera's tubers wrongly, lower refuses poses that are measured."""

# The belt plane (`plane`)
SAMPLE_STRIDE = 8
"""Pixels between samples, both ways: about 6000 at 848x480. Half costs four times as much."""
BAND_M = 0.004
"""Metres; samples this close to a plane support it. Narrower loses support on noisy cameras, wider takes in soil."""
FIT_BANDS_M = (0.008, BAND_M, BAND_M, 0.003, 0.003)
"""Metres; bands of the successive least-squares fits: wide at first, for three noisy samples made the first plane."""
BELT_QUANTILE = 0.3
"""Of the rows' mean heights, where the belt lies between cleats; these cover up to a third of it. On 17 flat simulated
belts at 0.345 to 0.55 m the belt is seen 0.1 mm too near in the mean (-0.3 to +0.4); by least squares alone 0.4 (0.0 to
0.8). A quantile of 0.25 sees it at 0.0, one of 0.5 at 0.3."""
ROW_SAMPLES, LEAST_BELT_ROWS = 12, 12
"""Samples of belt that a row needs, and rows that tell; with fewer the fit stays as it is."""
MIN_SAMPLES = 300
"""Samples; fewer are no image of a belt."""
MIN_FIT_SAMPLES = 50
"""Samples inside a band; fewer fix no plane."""
MIN_SHARE = 0.15
"""A plane that fewer of the samples support is not taken for the belt. Higher refuses crowded belts, lower may take the
tops of a layer of tubers for the belt."""
MOSTLY = 0.5
"""Share of the image's middle that a plane must fill to be the belt with a floor beside it."""
FLOOR_BELOW_M = 0.06
"""Metres; a plane that far above all else is the belt, and what lies lower is the floor."""
LOAD_M = 0.1
"""Metres; the load on a belt is lower than this."""
REFUSE_M = 0.020
"""Metres; a given belt that is farther off, with nothing seen where it should be, is refused: a millimetre is worth
about 2.2 % of a load."""
DRIFT_M = OFF_MM / 1000
"""Metres; farther off than calibration and wear explain: an alarm, and no longer followed. In the suite, whose
belts are known to 2 mm, the belt was seen at most 3.1 mm off."""
TILT_OFF_DEG = LEANS_DEG
"""Degrees between the belt seen and the belt given that are an alarm; a calibrated belt stays below 0.3."""
TILT_WORTH_DEG = 0.5
"""Degrees; a smaller tilt is taken for none. A tilt of 3 degrees taken for none costs a fifth of all tubers."""
TILT_SURE_DEG = 1.5
"""Degrees from which on it is seen for sure: a given pose that looks straight down to the last digit was assumed. Of 40
simulated cameras of `harsh`, and 12 of `field`, that look straight down none seemed to lean by more than 1.2."""
CLEAR_SHARE = 0.25
"""A plane that more of the samples support is seen clearly: it may contradict the calibration."""
CONSENSUS_TRIES = 120
CONSENSUS_SCORED = 1500
"""Random planes, and samples that each is scored on. Where a third of the coarse cells shows belt, one try in 27 has
three of them, and 120 tries miss all with 1 %. Fewer are quicker: they are most of a fit's time."""
CLEAR_SPAN = 1e-4
"""Twice the area, in normalised image coordinates, that three samples must span to fix a plane."""
CONSENSUS_FAR = 0.15
"""Of a coarse cell's samples, from the farthest, the one that stands for it: belt between the tubers, but no hole."""
BELOW_M = 0.010
"""Metres; samples this far below a plane count against it, for nothing lies below the belt."""

# Following the belt (`belt_keeper`)
FITTED_OVER = 15
"""Frames that a fitted belt is the mean of, and checks that a followed belt is the median of."""
SEEN_SD_M = 0.0005
"""How well a belt is seen, standard deviation: soil, cleats and feet of tubers move it by up to 0.5 mm. More goes by
what is given."""
AGREE_M = 0.0025
"""Mean distance of checks from their median above which they do not agree, and a given belt stays: 0.2 mm on flat
belts, 1.9 mm on one that heaves by 3 mm, more where another surface is seen now and then."""
CHECK_EVERY = 30
"""Frames between checks of a known belt: once a second."""
BELT_PATIENCE = 60
"""First frames of a run without any belt, or with another than is given, before the run is refused: two seconds."""

# What is on the raster (`heights`, `instances`, `edges`)
CEILING_MM = 250.0
"""Millimetres; what is seen higher above the belt (a hand, a cable) is no load and taken as unseen."""
GAP_MM = 15.0
"""Millimetres; gaps in the depth up to this width are closed with the lower of their two sides. Wider would bridge the
belt between two tubers."""
QUANTUM_MM = 0.5
"""Millimetres per step of the 8-bit raster, which ends at 127 mm. Finer would cut tall tubers off."""
COARSE_QUANTUM_MM, TALL_MM, TALL_SHARE = 1.0, 120.0, 0.01
"""The same where more than that share of the cells is higher than `TALL_MM`: the raster then ends at 255 mm. Of a heap
four tubers high, cut off at 127 mm, 17 of 60 were counted; with this 28."""
LEAST_SEEN_OF_RASTER = 0.5
"""Share of cells; where less has depth, as in a recording of tubers cut out already, depth ends at every tuber."""
LEAST_ROWS = 3
"""Rows or columns of an instance that must end at the unseen band: one ragged cell is no cut."""

# Watching the belt (`watch`)
KEPT_CHECKS = 5
LEAST_CHECKS = 2
"""Checks. One frame's plane may be off; the median of the last few is not."""
LEAST_STEP_M = 0.003
LONGEST_STEP_M = 0.03
"""Metres between two frames: tubers that moved less or more say nothing of the direction."""
SAME_M = 0.006
"""Metres; a tuber this close to where it is expected is the same."""
LEAST_VOTES = 20
BACKWARDS_SHARE = 0.8
"""Tubers that must have voted, and share of them, before the belt is said to run backwards."""
BACKWARDS_M = -0.2
"""Metres; an estimated travel this far back is no shaking belt."""

# Watching how the load moves (`motion_watch`)
SHIFT_SAME_M = 0.005
"""Metres along and across the belt within which two pairs of tubers moved alike. Less loses tubers that rock, more
takes neighbours for one another."""
SHIFT_AREA = 0.35
"""Logarithm of two visible areas that may be one tuber's: it is seen from another side, or touches another one."""
SHIFT_KEPT, SHIFT_LEAST, SHIFT_LEAST_M = 60, 15, 0.25
"""Moves that are kept, and moves and metres of them that are needed to say anything: a jolt is no finding."""
SHIFT_ASIDE_M = 0.03
"""Metres across the belt by which pairs of tubers may lie apart: a camera turned by 50 degrees, at 40 mm a frame."""
TURNED_DEG, TURNED_ALIKE = 5.0, 0.8
"""Degrees by which the load must move aside of the belt's x to be a finding, and share of moves that must go to that
side. On simulated belts a camera that is turned by 8 degrees against its pose counts right, one that is turned by 10
counts half of the tubers twice; how cameras were turned was found to 0.6 degrees."""
SHIFT_OFF, SHIFT_OFF_SHARE = 0.12, 0.6
"""Share of the way seen by which the way told must differ, over all moves kept and in so many of them. On simulated
belts an encoder that is 10 % off changes places and no count, one that is 20 % off counts half of the tubers twice."""
COARSE_M, COARSE_STOOD = 0.03, 0.2
"""Metres of the steps in which travel is told, and share of the moves in which it stood still while the load moved. On
simulated belts travel in steps of 35 mm counts right, in steps of 40 mm and more one tuber in 24 counts twice."""
