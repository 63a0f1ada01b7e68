"""Digits that move on a sensor of 320x240, found and named as they appear.

    python examples/several_digits.py

Six bundled recordings are put anywhere on the sensor and begin one after the other. A decision is
made every 10 ms. An object is printed when it first has a class with a probability above `SURE`,
and when its class changes.
"""

import numpy as np

import async_tnt
from async_tnt.sources import open_recording, sample_recordings

SENSOR = (320, 240)
SIDE = 34  # pixels of a recording, in width and height
CELL = 80  # pixels of a part of the sensor that has one digit at most
N = 6  # digits
APART_US = 60_000  # from the start of one digit to the start of the next
SURE = 0.8


def scene(rng: np.random.Generator) -> tuple[np.ndarray, list[tuple[int, int, int]]]:
    """All events, in order, and each digit with the middle of its place."""
    cells = rng.permutation(12)[:N]
    parts = []
    places = []
    for k, (digit, cell) in enumerate(zip(rng.permutation(10)[:N], cells, strict=True)):
        left = CELL * int(cell % 4) + int(rng.integers(CELL - SIDE))
        top = CELL * int(cell // 4) + int(rng.integers(CELL - SIDE))
        events = open_recording(sample_recordings()[int(digit)]).read()
        events["t"] += k * APART_US
        events["x"] += left
        events["y"] += top
        parts.append(events)
        places.append((int(digit), left + SIDE // 2, top + SIDE // 2))
    events = np.concatenate(parts)
    return events[np.argsort(events["t"], kind="stable")], places


def main() -> None:
    events, places = scene(np.random.default_rng(0))
    print("there are", ", ".join(f"{digit} at ({x}, {y})" for digit, x, y in places))
    model = async_tnt.load_model("digits-everywhere").for_sensor(SENSOR)
    packets = np.array_split(events, 100)
    known: dict[int, str] = {}
    for decision in async_tnt.stream(packets, model, every_us=10_000):
        for found in decision.objects:
            if found.probability > SURE and known.get(found.id) != found.label:
                known[found.id] = found.label
                print(
                    f"{decision.time_us / 1000:4.0f} ms  object {found.id} is a {found.label}, at "
                    f"({found.x:.0f}, {found.y:.0f}), with probability {found.probability:.2f}"
                )


if __name__ == "__main__":
    main()
