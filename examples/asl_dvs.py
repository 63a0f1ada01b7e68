"""ASL-DVS, 100,800 recordings of the letters of American Sign Language in MATLAB files, as NumPy
files.

    python examples/asl_dvs.py ASLDVS asl
    async-tnt train asl --out asl.safetensors

Each file `<letter>/<name>.mat` has vectors x, y, ts and pol. Pixels are kept as they are: they
count from 0, and the pictures are turned by 180 degrees. `pip install scipy` reads the files.

References
----------
Bi, Chadha, Abbas, Bourtsoulatze, Andreopoulos 2019, Graph-Based Object Classification for
Neuromorphic Vision Sensing, ICCV.
"""

import sys
from pathlib import Path

import numpy as np
from scipy.io import loadmat

import async_tnt

SENSOR = (240, 180)


def main(source: str, folder: str) -> None:
    paths = sorted(Path(source).glob("*/*.mat"))
    for path in paths:
        variables = loadmat(path, variable_names=("ts", "x", "y", "pol"))
        events = np.empty(variables["ts"].size, async_tnt.EVENT_DTYPE)
        for field, name in (("t", "ts"), ("x", "x"), ("y", "y")):
            events[field] = variables[name].ravel()
        events["p"] = variables["pol"].ravel() > 0
        out = Path(folder, path.parent.name, f"{path.stem}.npz")
        out.parent.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(out, events=events, sensor=SENSOR)
    print(f"{len(paths)} recordings in {folder}")


if __name__ == "__main__":
    main(*sys.argv[1:])
