"""A loop over packets, as a camera's driver delivers them.

`push` returns the decisions that a packet causes: one for each window that it closes. `fire`
decides in between, whenever the program asks, and changes nothing.
"""

import async_tnt
from async_tnt.sources import open_recording, sample_recordings

model = async_tnt.load_model("digits")
processor = async_tnt.Processor(model)


def show(decision: async_tnt.Decision) -> None:
    time_ms = decision.time_us / 1000
    print(
        f"{time_ms:7.1f} ms  {decision.trigger:<6}  {decision.events:5} events  "
        f"{decision.label} ({decision.probability:.0%})"
    )


packets = open_recording(sample_recordings()[3], packet_events=250)  # stands for the camera
for number, packet in enumerate(packets, start=1):
    for decision in processor.push(packet):
        show(decision)
    if number % 4 == 0:  # the program wants to know now
        show(processor.fire())
for decision in processor.finish():  # the stream has ended: decide the open window
    show(decision)

counts = processor.counts
print(
    f"{counts.received} events: {counts.kept} kept, {counts.dropped_outside} moved off the grid, "
    f"{counts.dropped_tau_zero} at the start of a window"
)
