"""Texts of RESULTS.md in Markdown: how its tables were measured, and what limits their numbers."""

INTRODUCTION = """\
Written by `python -m experiments.pages`; do not edit. The tables are made of the files in
`results/`, of the record inside the bundled model `digits` and, where they say so, of numbers from
papers. The texts are written by hand. [What they say](../docs/results.md), with the most important
tables. Some results are of earlier versions, and were not measured again. Where nothing else is
said, timings are medians, on shared virtual machines with two cores."""

DECISIONS = """\
What is compared runs in one process, on one thread each, warm, taking turns. At each timed moment
all must give the same logits within 1e-4 (of the largest logit, if this is above 1), but for
eventcv, whose volume is another one. *In blocks*: 50 decisions in a row, so that each network has
the caches to itself. *Call by call*: the networks alternate at every decision. Ratios are medians
of the ratios of single decisions or, in blocks, of the ratios of the blocks' medians. Latency is
wall-clock time, throughput processor time. OpenVINO uses float32 and the hint LATENCY."""

STARTS = """\
A fresh process, to its first decision. The kernels were compiled before, as `pip install .` does it
or, in a checkout, `python -m async_tnt.kernels.ship async_tnt/kernels/compiled`. So nothing is
compiled at the first start, with an empty cache; without these files, everything is."""

NETWORKS = """\
Random weights, on the bundled recordings, whose pixels are mapped onto each grid: that of the
thesis; `conv4`, four convolutions with batch norm and max pooling; `residual`; and one for
gestures, a 2x2 stem of stride 2 and four 3x3 convolutions with average pooling. Measured as the
[decisions](#decisions) above, with 40 decisions in a block."""

LAYER_TIMES = """\
Networks that end behind each layer with weights take turns; a part takes what its network takes
more than the one before. Each time is the least of four, and the numbers are means over 1,000
moments. Multiplications by an input that is 0 count, although many of them are left out, so a share
can be above 100 %."""

ZOO = """\
Networks of event-camera papers, retyped, and of libraries, with random weights; batch norms have
the statistics of sparse inputs. The list was fixed before any of the operations was written that it
asks for; the size of one input was too small for its network, and was doubled later. Events of a
moving spot change one pixel each. Bits are compared after each of 30 events with a whole pass;
deviations are those from torch in float64 after the last one, as a share of the largest number,
beside that of torch in float32. An event and a whole pass of ONNX Runtime take turns, 20 times, on
one thread; the pass reads a finished volume. Where numbers grow from layer to layer, as random
weights let them, rounding grows, too."""

PIXEL_OUTPUTS = """\
FireFlowNet (F. Paredes-Valles et al. 2021) with random weights: a vector of flow for each pixel of
the sensor. Measured as the networks above."""

VOLUMES = """\
Landmark `running`, 8 cells, transform included; random events."""

CARS = """\
N-CARS (A. Sironi et al. 2018, [arXiv:1803.07913](https://arxiv.org/abs/1803.07913)): 15,422
recordings to train on and 8,607 to test on. Each row is `async-tnt train n-cars_train --sensor
120x100` with its options. The options of the first row were chosen on the last fifth of the
training part; its networks hold out the last twentieth. When all networks of a row were trained,
each read the test part once. Networks of earlier versions had read it, too, some with other
options. The last row is a table of the widths and heights of the training crops, smoothed over two
pixels. It sees no event: a shortcut that every network on these crops may take. The published work
after an event, and its accuracies, are those of table 1 of S. Schaefer et al. 2022
([arXiv:2203.17149](https://arxiv.org/abs/2203.17149)). [Sources](../docs/results.md#cars) of the
other methods in the picture."""

WITHOUT_OPTIONS = """\
`async-tnt train` with the sensor's size alone, N-MNIST without any option. Each network read the
test part once, as networks of earlier versions had done. N-MNIST: the project's Train and Test,
8,000 recordings to learn from and 1,000 to test on, not the official split. POKER-DVS: 48 and 20.
HOTS' characters: 36 and 40. Training holds out a fifth of the recordings of N-MNIST and of
POKER-DVS."""

DEFAULT = """\
One network each. No test part of the project was read: held out are the last recordings of each
class (those of N-MNIST are of its official test), of HOTS' characters the end of each recording,
and of `sessions`, which is made, a second session with other thresholds, noise, places and sizes.
In `sessions`, whose objects move far within a window, counts lose accuracy to time bins. On N-CARS,
bins lose accuracy to counts. On the other sets both are equally good. The sets are told apart by
the number of events of one polarity that an active pixel has in a window: on N-CARS it is below
2.25, on the others above. From 2.25 on the default is five bins; that value was set after these
five sets. N-CARS and N-MNIST: ten epochs; without `--mirror`.

These networks are of version 0.1.0. A default training may end early now, so that the same command
may train POKER-DVS, the characters and `sessions` for fewer epochs."""

INPUTS = """\
On each data set every input gets the same network, up to its first layer, and the same number of
steps. N-MNIST: trained on the first saccade, tested on all three ("1/all") or in 30 simulated
motions ("1/sim"); 3,000 steps, t_max 2, translations; volumes are signed, images split by polarity,
`line` has its flow removed. N-CARS: accuracy on the test part at the time given; six epochs,
`--mirror`, TNT with t_max 3, no flow removed. A dash was not measured. Costs, on N-CARS: an event
in the volume, and a decision after every event."""

EARLY = """\
The 1,000 test recordings of `digits`, a decision every 2.1 ms. Windows that do not reach a
confidence count with the decision at their end, after 105 ms. Nothing was chosen by these
numbers."""

NOTHING = """\
Windows with the times of the bundled recordings' events, which stand somewhere else, and other
objects. Training showed `digits` noise, one polarity, hot pixels, patches and straight edges, by
code of its own. It was not shown pairs, nor what is marked "tested only". Of HOTS' characters, the
ten digits are left out, because `digits` has classes of their names."""

RECIPE = """\
Not the official N-MNIST test: training used the official training recordings 1-1,000 and 7,000 of
the official *test* recordings, the test 1,000 others of these, 100 per digit. The standard error is
0.2-0.3 %. The model: TNT about the running centroid, t_max 4, nine bins of 105 ms on 34 x 34
pixels, 16 and 32 convolution channels, 64 hidden units, 137,738 weights.

It was trained in five steps. The fourth also showed scattered events, the fifth all kinds of
nothing of `train`; half of the fifth step's target is what the fourth model says. .27 of the
weights are the fourth model's, .73 the average over the fifth step; the probabilities are
calibrated. `python -m experiments.digits` makes these steps again in two hours, with one
difference: its fourth step shows all kinds of nothing, too.

Data: 7,201 real and 20,000 simulated recordings of MNIST training images from 5,000 on; 799 real
ones were held out. Augmentation: the window's start moves by up to 5 ms, events by 1.5 px, rotation
10 degrees, scale and shear 10 %, up to 30 % of events dropped, every fifth window (in the last two
steps every second) cut at 15-105 ms; in these, every fifth or 15 % of the windows show nothing.
AdamW, decay 0.01, batches of 64, cosine rate from 0.002 (then .001, .001, .0005, .001), label
smoothing 0.05, seed 0.

Trainings were compared on held-out recordings, and on the bundled samples, which are therefore no
test: the two models were mixed with the largest share of the last at which all samples are right.
0, 7, 8, 9, 11 and one training that is not in the table have read the test; none of these results
decided anything."""

THESIS = """\
Columns: trained on / tested on. *all*: all three saccades; *1*: the first; *others*: the second and
third; *train*: all three of the training digits; the other columns are nine sets of 30 simulated
motions, and *sim v2e*, the motions of *sim* as the pixels of v2e see them. The rows were listed
before the first was trained; they share network and optimizer. Mean ± standard deviation over the
networks, which differ in their seeds; where there is one, without deviation. A dash, or a missing
column, was not measured: the commands below train the networks of this page, and without `--rows`,
`--trained-on` and `--seeds` the command trains all. Each network has a file in `results/thesis`,
with its commit, machine and steps. N-MNIST's recordings are split as for `digits` (7,201 to train
on, 799 held out, 1,000 to test on), and none is simulated; of MNIST's test images 500 are simulated
that no training recording shows. No number of the second or third saccade or of the simulated
motions chose a row, a setting or a number of steps of this table; in other motions the numbers of
earlier versions had been seen.

The thesis' own rows scale time from a window's first event to its last, with t_max = B - 1 = 8, and
move windows in training for the regressor alone, as the thesis does. They have 8,000 steps, the
thesis 60,000.

In the comparison t_max is 2. On held-out digits of the first saccade 2, 3 and 4 have nearly the
same loss, and 8 has a larger one.

Intervals hold for other seeds and other digits: with d the differences of S seeds and I digits, the
variance of their mean is that of the seeds' means divided by S and that of the digits' means
divided by I, as a bootstrap that draws both has where both are many (A. B. Owen 2007,
[arXiv:0712.1111](https://arxiv.org/abs/0712.1111)), with Student's quantiles. A difference *holds*
if it does so by Holm's method at .05 among all of its question, in all columns. There are few
seeds, so what holds depends much on how well the networks of a row agree: a large difference may
not hold where a small one does."""

LAYERS = """\
Equivariance errors of `digits`' layers: how far the features of one digit with flow added, the
first saccade of the bundled 3, are from those without, translated by whole cells of the layer;
[drawn](../docs/theory.md#the-temporal-normalization-transform). t_max is 2. `digits` was trained on
TNT about the running centroid with t_max 4; its weights have not seen the other inputs."""

EDGES = """\
The recordings 1 to 1,000 of N-MNIST's official training part; each saccade's events are moved back
onto the MNIST image that was shown."""

MOTIONS = """\
All networks are trained for 8,000 steps; the motions of a row are made once, for all seeds. The
controls are cheap ways to other directions, on the same recordings: windows turned by any angle;
shown reversed in time, with polarities swapped, as often as recorded; shown flipped in x, in y and
in both, as often as recorded; without polarity; all of them together.

**What these rows do not show.** The prior of the re-synthesized motions (any direction, lengths
about those recorded, straight or bent, constant or like a saccade) was written by somebody who knew
the test motions, and contains them. Re-synthesis and the simulated sets share one model of a pixel,
with the same thresholds' mismatch; *sim v2e* does not. The set *beyond* has what the prior does
not: 14 px, there and back, round a loop. Earlier versions, with fewer variations of a window, were
tested on saccades 2 and 3 and on the simulated set. The image's prior and the random places were
changed after that, and the number of variations was chosen on held-out recordings in re-synthesized
motions. No result of these tests led to these changes. The accuracies of `train` itself, trained on
the first saccade, stand [below](#few-events-in-motions-that-were-not-recorded)."""

FEW = """\
Trained in one direction, or in all; means over networks, which differ in their seeds (lowest to
highest). Saccades: 4,800 recordings of N-MNIST's Train show the first one, or all three in turn;
the 1,000 of Test show the first one or, in other motions, the second or the third. With all events:
the first saccade of all 8,000 of Train at hand, by the same command; all saccades of Test, and
3,000 other test images in the 30 motions of *sim*; each network read both once. Re-synthesis learns
in time bins, the others from counts.

Hands: eight dark objects, 1,280 recordings that move to the right, or in eight directions; 320 in
each test; 25 epochs, and as many steps with the cheap ways to other directions. The eight objects
were chosen by test accuracies: those of networks that were trained on one direction and on all.

The networks of the saccades are of versions 0.1.0 and 0.2.0. A default training may end early now,
so that the same commands may train them for fewer epochs."""

PATHS = """\
Right: within 45 degrees, of the median at full rate or of the swing. The rows of N-MNIST and of
noise are no test: by them the constants of the rules were set. Their recordings are of the
project's Train, most of them of N-MNIST's official test. Hand motion (2 to 3 pixels, 1.2 to 2.7
events each, `experiments/objects/hands.py`) set no constant. Paths only shift: where objects turn
by 16° or grow by 25 % in a swing (standard deviations), fewer paths are found than in session 1,
and fewer of these are right."""

FROM_PICTURES = """\
No event was recorded. N-MNIST and made objects: one command each, `async-tnt train PICTURES` with
its options. POKER-DVS and HOTS' characters are crops that follow an object. The networks are of
version 0.2.0, whose `train` simulated such crops (`--follow`); no option of today's `train` does,
and the commands below use a function of their own for these two. A default training may also end
early now.

N-MNIST: MNIST's 60,000 training images; read are all 8,000 official test recordings at hand.
POKER-DVS: pips drawn with the fonts of Debian 12's packages `fonts-*` of up to 15 MB but
`fonts-pc*`, whose fonts are bitmaps. HOTS' characters: fonts of the packages of up to 1 MB; digits
and letters are classes of their own, O and 0 and I and 1, too. Pictures that are alike count once.
Made objects: ten pictures of each of six, a cup and a glass alike but for a detail. N-MNIST's
networks were trained when thin objects seen from aside still lost more of their area.

Most choices were made on simulated recordings of held-out pictures. Real recordings had a part in
others, official test recordings of N-MNIST among them:
[which](../docs/theory.md#what-came-from-recordings). That pips are drawn upright was chosen after a
look at real ones. Networks of other versions had read the real recordings before: those of N-MNIST
and POKER-DVS several times, the characters, too."""

TEACHING = """\
Each digit is left out in turn, in the order 4, 6, 2, 7, 3, 5, 9, 0, 8, 1, which was drawn.
`async-tnt train --sensor 34x34` trains on the nine others, of the project's part Train of N-MNIST
(not the official split). Then `Model.with_class` teaches the tenth from 1, 5, 10 or 50 recordings
that are drawn from Train, five times. *Everything again* is the same command on the nine digits and
the first draw of recordings together (`--again`). It holds a fifth of each class out, also of the
new recordings; teaching uses all of them. *Trained further* is the network of nine, with a new
logit, after four more epochs on the same (`--fine`). Its settings were not tuned. Both were done
for one or two digits only, as the column of digits says: no more than a first look.

Each network read Test once, and Test decided nothing: the settings were chosen on recordings of
Train that training held out, with 4 left out (`--settings`; 6 was added later). The layer was
chosen there, too, in a pilot that is not recorded.

*Told* is the share of the nine digits that the new class takes by the statistics alone, and
*counted* that on Test. Windows that show nothing are of the eight kinds of `experiments.nothing`,
100 of each; *sure* is a probability of .9 for any class. Before the end are a quarter and a half of
a window."""

FEW_PICTURES = """\
How many real recordings of each class a classifier of N-MNIST needs, with MNIST's 60,000 training
images and without: `async-tnt train FOLDER --sensor 34x34`. Each network reads the 1,000 recordings
of Test once, as did networks of an earlier version that recorded each picture once. There is one
network of each kind, so small differences may be chance. The networks are of version 0.2.0; a
default training may end early now."""

EVERYWHERE = """\
`digits-everywhere`, trained by `async-tnt train FOLDER --sensor 34x34 --size 0.5-0.7 --window-us
105000 --volume representation=volume,bins=2,polarity=split,transform=none --everywhere --epochs 34`
on N-MNIST's Train (not the official split) and 10,000 of MNIST's training images
(`python -m experiments.everywhere --write FOLDER`), on scenes of the 1,000 recordings of Test,
which begin up to 50 ms apart, with noise of .3 Hz a pixel: an object is found by its class within 5
pixels of its middle. Networks and training were chosen by scenes of held-out recordings of Train.
Test had been read before: by this network, by two models that were bundled before it, by one with a
coarser map, by four of other seeds, and by the network of *Boxes*. In noise alone nothing was found
in 330 windows. The network was trained when an object's middle was that of all its window's events,
not only of those that a scene shows.

*Boxes*: one network of `async-tnt train FOLDER --everywhere` without other options, on the same
data. It was trained when sizes weighed .1 in the loss, a weight that was chosen by F1 of held-out
recordings of Train; today's command weighs boxes by .3. It read Test once. mAP is COCO's, at the
end, with boxes from the 2nd to the 98th percentile of an object's events."""

OBJECT_SCALES = """\
A network for objects of many sizes: longer sides of 1/12 to 1/3 of the sensor's shorter side. It
learns from 400 PNG pictures and no recorded event (`async-tnt train --everywhere --scales`), in
scenes of 240x180 pixels, in windows of 50 ms: eight kinds of drawn objects, and other things, which
are a class that is not scored. On 640x480 the same network is used by `Model.for_sensor`.

The test scenes show these kinds as another module draws them. Their renderer and their pixels share
no code with the package, nor with the drawing of the pictures. 3 to 6 objects move, turn, grow and
cover each other, before a textured background, with noise, hot pixels and two to four moving things
that are no objects. The renderer was committed before anything was trained. Choices were made in
scenes of another seed: the length of windows, the weights in the loss, which objects count in
training, pictures of other things, the network and how much its boxes weigh (the two networks whose
boxes weigh a tenth were trained again for the table, after the final set was scored). The final set
(seed 404) was scored once by each of five networks, which differ in their seeds. Two earlier final
sets were scored once by networks of earlier versions: seed 202 by one whose pictures had the
outlines of the scenes, seed 303 by five with maps of two sizes.

*F1*: the middle of a box of the right class lies in the ellipse that touches the sides of the true
one. *mAP* is COCO's. A scene begins with a window, so that 100 ms is the end of the second one.
True boxes are where objects are at that time."""

FLOW = """\
The network of `examples/flow_per_event.py`: six convolutions of 3x3 on windows of 30 ms in eight
bins, at a quarter of the resolution, enlarged at the end. It is trained on simulated scenes of
64x64 pixels: grounds of noise, patches or checks, with polygons, ellipses and stars in front. All
objects, and four of five grounds, move along a straight line (20 to 300 px/s), turn and grow; the
other grounds stand still. Pixels are drawn as for [pictures alone](#pictures-alone). *Others* shows
brick walls, rings and letters, on paths that are bent. A sequence has 128x96 pixels and 120 ms. At
200 of its events, drawn at random after the first 30 ms, the flow of the event's pixel right after
the event is compared with the true flow there. Test sequences chose nothing; networks differ in
their seeds.

*Network*: windows that lie end to end. *Overlapping*: a window opens every 15 ms, and the oldest
answers, with 15 to 30 ms of events. *Plane fit*: a plane through the newest events around an event,
after Benosman et al. 2014; its flow is that along the edge's normal, and zero where no plane is
found. *Pooled*: one flow through the normal flows of a larger neighbourhood, so that edges of
several directions tell it. The settings of both were chosen by the error on 20 other sequences of
scenes as trained: drawn at random, then one after the other.

Times: events and whole passes take turns, one thread, overlapping windows, each flow of a whole
pass the same to the bit (onnxruntime and torch: within 1e-4 of the largest). A window that takes
over from another one shares no computed place with it: its first event costs more than a whole pass
of async_tnt or onnxruntime."""

BOX_COST = """\
The bundled `digits-everywhere` with two more channels of random weights, which say sizes, beside
the same without them, on the same moving recordings by turns. Timed are one event and the decision;
300 events and a decision between two of these are not. The objects are the same, but for those that
a likelier box suppresses."""

SLIDING = """\
Events of a spot that moves, into an image of counts or into five bins, split by polarity; packets
and windows take turns. The decisions are those of RoShamBo's network (Lungu et al. 2017) with
random weights on an image of counts of both polarities, 64x64 pixels, with about 5,000 events in
the window: 1,000 decisions of each kind by turns, of `window_events` 100. Each image of the last
events is verified to hold exactly the last 5,000, and each of its decisions to have the bits of the
whole network. An event that comes and one that leaves change two places, far apart, so that they
reach a third more multiplications than two new events of a growing window. `window_events` computes
its image again from all events."""

SLIDING_TRAINING = """\
Networks of counts, trained by `async-tnt train` with `--window-us` or `--last-us` of the same
length and the same other options. Test recordings are streamed with a decision every fiftieth of a
window. At a moment since a recording's first event the newest decision counts, whichever window it
is about; before the first one none is right. N-MNIST: trained on the project's Train, which has
7,000 recordings of the official test, and tested on the 1,000 of the project's Test; windows of 105
ms. N-CARS: tested on 8,607 recordings, as long as a window of 100 ms; 6 epochs, mirrored. The table
names the mean over time of each network; with one network, a difference of .002 says nothing. Each
network read the test part once in each kind of window; nothing was chosen on it."""

SPIKING = """\
The spiking network of the NIR paper for N-MNIST (J. E. Pedersen et al. 2024,
[doi:10.1038/s41467-024-52259-9](https://doi.org/10.1038/s41467-024-52259-9)), `cnn_sinabs.nir` of
its repository. An event is a unit impulse at its pixel, and goes through all layers at its own
time; a recording is one window, in which neurons are never reset. The recordings are 1,000 of the
10,000 of the official test, 100 of each digit. *Published* numbers are the paper's, of simulators
and of chips, on all 10,000: nothing here measured them.

*Spike for spike*: sinabs' integrating neurons, built by hand of the graph's weights in float64, get
one event in each time step. After every event are compared the spikes of each layer, those of each
output, and the membrane of each neuron; after a recording, the additions that spikes cause. NIR's
neurons fire above the threshold, sinabs' at it, and programs round sums in other orders, so that a
difference that begins at a membrane within 1e-5 of a threshold is counted apart; the rest of its
recording is not compared. Norse resets to a value, and snnTorch's neurons leak by a factor in each
step; they run small graphs with random weights, whose events are one step apart. snnTorch resets in
the next step by default, here at once. Norse's leaking neurons take an Euler step where ours decay
exactly, so they are not compared.

*Bins*: sinabs in float32; events of one pixel in one step add up. `sinabs.from_nir` keeps membranes
at -1 at least, which the graph does not say, so both are measured. *Work*: additions of a weight by
convolutions and dense layers. *ReLUs*: the network of the same layers that the spiking one was made
of, by `examples/nir_cnn.py`, in windows of 105 ms. Only what an event changes is computed.

*Made of it*: `spiking_from_rates` with so many spikes in a window where a ReLU is at its 99.9th
percentile, which is measured in the windows of 200 recordings of Train. A window is 105 ms; the
class of a recording is that of the largest sum of its windows' logits or spikes. *First kernel*:
`experiments.between_commits` with `--graph` and `--recordings`, beside a checkout of commit
f738e558; 23 recordings of Test, whose names end on 01 or 51; each commit five times."""

THREADS = """\
Two streams in two threads of one process: the time of one after the other, divided by that of both
at once."""

SUSTAINED = """\
Streams in real time, in packets of a millisecond, through `KeepUp`, which reads in a thread of its
own. Load: the rate that is wanted, divided by the one that takes a core. A packet has a whole
number of events, so the rate that is sent differs a little. Delays from the moment a packet was due
to the end of its decisions."""

SIMULATED = """\
*N-MNIST*: 200 recordings of its official test. *Simulated*: the same MNIST images under N-MNIST's
own motion. *Constant* and *bell*: N-MOVING-MNIST's motions, on 200 of the first 1,000 test images,
three motions each; the last with `--motions bell`. Constant motion spreads about as many events
evenly over the window, hence the longer intervals. With 8 px a digit's outermost image ring leaves
the sensor; it is empty in 98.9 % of MNIST's test images."""

UDP = """\
Two processes, UDP on loopback, datagrams of 100 events, 1300 bytes. Latency from just before
`send`; the plain socket's time is the system's. Delays count from the time an event was due at the
sender."""

OTHER_PAGES = """\
[The page of results](../docs/results.md#pictures-alone) shows what the commands `official_test`
(with `--at-hand`) and `published_weights` measure, [the
theory](../docs/theory.md#what-came-from-recordings) what `fit_pixels` does and what [`same_bits`
compares](../docs/theory.md#stream-equals-batch)."""
