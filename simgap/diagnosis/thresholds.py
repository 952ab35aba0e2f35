"""Every threshold that decides an attribution or a verdict, in one place.

chi^2/dof is of windows whose initial states are refitted. BIC is the Bayesian information criterion, chi^2 + k log N
(Schwarz 1978), with k the parameters (discrete choices count) and N the compared numbers. One number stands for one
question, wherever it is asked: what is evidence, what is noise, what is most, what matters, how widely to look.
benchmarks/sentinel.py holds them against records that set none of them.
"""

from __future__ import annotations

# What is evidence.

BIC_GAIN = 12.0
"""An effect is added, or kept, only if BIC falls by at least this much; of sets within it the one with fewest
parameters is chosen. Very strong evidence begins at 10 (Kass, Raftery (1995), J. Am. Stat. Assoc. 90(430))."""

LISTED = 10.0
"""Sets that are further from the answer by BIC can be told from it (Kass, Raftery (1995): above 10 "very strong")."""

AS_GOOD = 2.0
"""Sets within this BIC of the chosen one are listed whatever else speaks against them (same source: "not worth more
than a bare mention"); an answer with one that is not the same thing is at most `partial`. What every drive with a gear
has is taken in if it gains more: with 2 for all, a quadratic drag of 0.3 N m s^2/rad^2, a gain of 6 to 8, was found at
three joints of a rig that had none (tests/diagnosis/test_arms.py)."""

SURE = 2.0
"""Coefficients of two folds agree within this many standard errors of their difference."""

BY_CHANCE = 1e-6
"""What noise does more seldom is no noise: a piece of a record that stands out, misses that remember or that follow the
input. Of backlash that was taken for noise (benchmarks/undeclared.py, seeds 1001, 1002, 1004) the regression's F was 8
to 9, of noise of three laws on three plants 0.4 to 1.2 (benchmarks/noise_colours.py); the limit is about 3."""

TAILS = 4.0
"""Degrees of freedom of Student's t, by which errors ahead are scored and the usual size of a miss is estimated
(Lange, Little, Taylor (1989), J. Am. Stat. Assoc. 84, who find 4 for most of their data)."""

FAR = 5.0
"""So many standard deviations are more than noise: of a reading beyond all others or off its prediction; of the sum of
squares of a window. No miss so many usual ones large: nothing stands out. And so many times `BIC_GAIN` promised beside
a set within the noise is asked for: of three effects two came within it where the third promised 120 to 600
(benchmarks/undeclared.py, "three effects", seeds 1010, 1013, 1006), and a gain off by 0.05 %, as a test's rig takes
Euler's steps, promised 26."""

# What is noise.

FIT_QUALITY, NO_MORE_THAN_NOISE = 1.15, 0.999
"""Largest chi^2/dof of a model that reaches the noise floor, of fitted and of held-out windows; few numbers, which
scatter by more, are at the floor below this quantile of chi^2."""

# What is most, what matters, what are a few.

MOST = 0.5
"""Most of a thing is more than half: of what the best answer leaves above the noise, where another tier of effects, a
change in mid-record or a mask is to explain it; of an error in one place; of a coefficient, where folds are to agree;
of what an effect is worth, where another is to stand for it; of a noise, where it is to remember. Friction with memory
takes nearly all where it is, a wrong first window makes chi^2/dof fall twentyfold, sensors that remember show .78 and
more, mechanisms that were taken for them .26 to .46."""

MATTERS = 0.1
"""What is a smaller share matters to nobody: of an error (of its square, the square of it), of the noise that an effect
adds to the misses, of an excess that is explained but for it, of a step's error. Half the integration step must not
move the predictions of a fit by more of its misses: a Dahl friction that turned round within a thirtieth of what a step
travels "explained" a push, being as large as its misses there. Readings
20 ms late accounted for 4 % of the squared error and more."""

A_FEW = 0.05
"""A small part: of the readings (spikes, gross errors), of the predictions that carry most of the error, of the samples
at an extreme. The largest 5 % of a Gaussian's draws carry 28 % of the square, of a sine's 10 %."""

OUT_OF_SIGHT = 100.0
"""A hundredfold: columns under which the declared model misses by so much more are not tried further, and those with
which it misses by so much less are what the columns are; an effect that is worth so many times `BIC_GAIN` is not left
out for a trial; what the linear problem promises is believed to within so much: a fit that promises so much more than
the noise, once a set has reached it, is given up."""

# How widely the search looks: a larger number costs refits and may find more.

WIDTH, NARROW = 4, 2
"""How many of the best are tried further at each turn; fewer where each is a search of its own."""

LEAPS_ANYHOW = 3
"""Up to so many effects are tried wherever fewer do not reach the noise; more only where the linear problem promises
that they leave less than half of chi^2, and named only if halves of the data agree. Five effects instead of three left
nine tenths where nothing in the library explains the record ("strange pendulum" of benchmarks/diagnosis_cost.py), and
a hundredth or less where they were missing (benchmarks/many_effects.py)."""

SUBSETS_KEPT = 40
"""Sets of each size that the normal equations keep."""

SAME, SAME_PROMISE = 0.1, 1e-5
"""Fits whose chi^2, or BIC, differ by less are one; candidates whose promised drops differ by a smaller share are one
direction, refitted once."""

EQUIVALENT_CHI2 = 1.0
"""Two fits whose chi^2 differ by less predict the same: an exact equivalence if their sensitivities span the same, and
the end of a fit where no initial state still promises more."""

COLLINEAR, EXACTLY_COLLINEAR = 0.99, 1.0 - 1e-6
"""Projected sensitivities with a larger correlation are called hard to tell apart on this excitation; with the second,
they are the same direction."""

VISIBLE_SHARE = 1e-14
"""An effect is seen if more than this share of what it does to the readings (of its square) is not what other initial
states would do. Of an offset of the position of a mass that slides freely 2e-19 was left and less (rounding; positions
about 0 and about 1000 m), with a spring that swings it once in 15 minutes 3.5e-12 (a record of 10 s): tests/diagnosis/
test_names.py."""

PLAUSIBLE_RATIO = 5.0
"""Off the noise floor, a gain or property further from its declared value than this factor absorbs, not explains."""

LAGS_ASKED = 20
"""Misses remember if their correlations over so many readings together are unlikely of independent ones."""

NEAR = 3.0
"""What misses by no more than so many noises comes near it: an elastic joint or play that nobody named after a few
steps, which is then fitted to the end (`MOTOR_STEPS`); an engine with a set of effects, which then follows. Of those of
benchmarks/drive_library.py eight steps left 0.93 to 1.24 of the noise, of Dahl friction 980 and more. Of a Furuta
pendulum in an engine of 10 ms steps 27 noises were left with one of two true effects, 31 with both, 182 with none. And
so many times what white noise would show stands out: under dry friction such a window is begun afresh. Windows that had
ended in a valley of their own stood 1.6 to 6,700 times above their best."""

MOTOR_STEPS = 8
"""Steps of a first try of such a motor."""

SEVERAL_TRACES = 3
"""From so many traces on, folds are whole traces (one each at least); fewer are cut into blocks of windows."""

BRIEF_S, LOOK_BACK_SAMPLES = 0.2, 10
"""So short a time that what a plant lacks all the time hardly shows in it (s): gross errors within half of it are one
push, and the causal start of an h-ahead prediction is estimated from it (from a window, if that is shorter; from so
many samples at least). Pushes of benchmarks/other_plants.py last a tenth of a second."""

FEWEST_WINDOWS = 4
"""Both sides of a change in mid-record have so many fitted windows at least: with those that confirm each fills three
folds. With six a change in the second of two runs of 10 s was out of sight; with four it was told in four of five such
records (benchmarks/other_plants.py), each side with its right number."""

RAMP_ENDS = 13
"""Instants, evenly spread, at which a slow change may begin and end: twelfths of a record."""

SIDES_ALIKE = 1.8
"""Largest ratio of the spreads of motion and command before and after a change: in larger or smaller motion an effect
that is not in the library looks like another number of one that is."""

MOST_COLOURED = 10.0
"""A residual may be noise that remembers if chi^2/dof for white noise is at most this: noise of 20 ms at 200 Hz shows
7. What a driven pendulum of real hardware keeps shows 46, and taken for noise it hid the friction."""

LAGS_REMEMBERED = 5.0
"""After this many time constants of a lag (e^-5 is less than a hundredth) what was commanded before has faded."""

# When a fit has settled, from the drive with rests in benchmarks/dry_friction.py: ends that a window held up, at a kink
# where it comes to rest, still promised drops of chi^2 of .4 to 136; begun afresh they ended lower by 20 to 350.

SETTLED_PROMISE = 0.05
"""Largest drop of chi^2 that the linear problem may still promise of the parameters, in units of chi^2/dof where that
is above 1 (a step of less than a quarter of a standard error); of the initial state of each window `EQUIVALENT_CHI2`.
Under dry friction what fitting such windows afresh from several starts gains counts instead of the promise."""

# What a look at the data warns of. Judgement; tests/diagnosis/test_survey.py and test_reading.py hold them against
# recordings with such faults and without.

MIN_SAMPLES = 8
"""Fewer samples make no piece of a trace and no window: the noise estimate alone takes seven."""

SMALL_SWING_RAD = 1.0
"""Below it the sine of gravity and a spring correlate beyond 0.999."""

REST_SHARE = 0.2
"""A recording at rest for a larger share of its time says little."""

LAG_WORTH_SAYING_S = 0.002
"""A velocity that trails the derivative of its position by more (and by half an interval) was filtered."""

DERIVATIVE_SCALE = (0.8, 1.25)
"""Outside it the scale between a velocity and the derivative of its position is a unit, not noise."""

EXCHANGED_MISMATCH = 0.3
"""Columns of a position and its velocity are exchanged only where the one is the derivative of the other but for this
share at most. Of swapped records of benchmarks/recording_faults.py, friction ten times as strong among them, 0.02 to
0.18 was left at a scale of 0.97 to 1; the wrong way round 0.29 to 1 at a negative scale, on seven plants."""

STILL_NOISE, STILL_STEPS = 8.0, 2.0
"""A block whose range is within so many sigma of noise, or steps of resolution, is at rest."""

WHOLE_WITHIN, CUT_OFF = 0.02, 0.2
"""A channel is quantised if its steps, but for this share, are whole multiples of the smallest, to within this much of
one. Single steps that differ by a larger share than the second of their size are no counts: of continuous readings they
differ by up to 0.4, of counts that a file holds to a twentieth of a count by 0.1."""

STALE_MISS, STALE_STEPS, LEAST_STALE = 1.0, 1.5, 0.002
"""Repeated readings are stale if a fifth of them miss the line between their neighbours by so many sigma (each by so
many steps of an encoder); few of them are chance."""

SPIKE = 15.0
"""A reading is a spike if it bends away from its neighbours by so many robust standard deviations of the bends of its
channel."""

HUM_LINE, HUM_ACCELERATION = 60.0, 2.0
"""A line stands this far above the median around it (of 10^4 frequencies of white noise the largest stands 15 above),
and is hum if as a motion it would take so many times the acceleration that the motion shows below half its
frequency."""

MOST_FOLLOWED = 24
"""Over so many windows a simulator is held against the recordings."""

RUNS_DIFFER = 0.1
"""Runs are taken for one piece each if their blocks would differ as much by chance in fewer cases than this. Wide on
purpose: equal runs that are taken for different ones cost confidence, different ones that are taken for equal cost
coverage. Of records of six runs, 100 residuals each that correlate by 0.5, whose scales differ by exp(N(0, 0.3)), it
finds 97 %; of four equal runs, 400 residuals each that correlate by 0.9, it takes 18 % for different."""
