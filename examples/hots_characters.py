"""The characters of HFirst and HOTS, 76 recordings in one MATLAB file, as a data set of class
folders.

    python examples/hots_characters.py ExtractedStabilized.mat characters
    async-tnt train characters --test --out characters.safetensors

The file has a cell array `ROI` of structures x, y, p, ts; pixels count from 1, and OFF is -1. Its
recordings have no labels: 36 characters pass by in a fixed order, then all of them again, and the
first four once more. The first 36 recordings are to train on, and the others to test on.

References
----------
Orchard, Meyer, Etienne-Cummings, Posch, Thakor, Benosman 2015, HFirst: A Temporal Approach to
Object Recognition, TPAMI.
Lagorce, Orchard, Galluppi, Shi, Benosman 2017, HOTS: A Hierarchy of Event-Based Time-Surfaces for
Pattern Recognition, TPAMI.
"""

import sys
from pathlib import Path

import numpy as np
from scipy.io import loadmat

import async_tnt

# as the list of labels beside the file, in VictorBoutin/HOTS on GitHub
ORDER = "XFYGZH0I1J2K3L4M5N6O7P8Q9RSATBUCVDWE"
SENSOR = (32, 32)


def main(file: str, folder: str) -> None:
    recordings = loadmat(file)["ROI"].ravel()
    for k, recording in enumerate(recordings):
        columns = {name: recording[name].item().ravel() for name in ("x", "y", "p", "ts")}
        events = np.zeros(columns["ts"].size, async_tnt.EVENT_DTYPE)
        events["t"] = columns["ts"]
        events["x"] = columns["x"] - 1
        events["y"] = columns["y"] - 1
        events["p"] = columns["p"] > 0
        part = Path(folder, "Train" if k < len(ORDER) else "Test", ORDER[k % len(ORDER)])
        part.mkdir(parents=True, exist_ok=True)
        np.savez(part / f"{k:02d}.npz", events=events, sensor=SENSOR)
    print(f"{len(recordings)} recordings of {len(ORDER)} characters in {folder}")


if __name__ == "__main__":
    main(*sys.argv[1:])
