"""Tasks on small files, and functions of them that use no model; worker processes import them."""

import os
import signal
import time

from async_tnt.evaluation.job import Job, task_of
from async_tnt.evaluation.records import evaluate_recording, failed_record

JOB = Job("digits", model_sha256="a" * 64)


def make_tasks(folder, names, job=JOB):
    """A task of each name; the files hold their names."""
    folder.mkdir(exist_ok=True)
    for name in names:
        if not (folder / name).exists():
            (folder / name).write_text(name)
    return [task_of(name, folder / name, job) for name in names]


def record_of(task):
    """A complete record, which depends only on the file's content, apart from the seconds."""
    text = task.path.read_text()
    return failed_record(task, "") | {
        "label": text,
        "probabilities": [0.1 + 0.2, 0.75],
        "decisions": [{"events": len(text)}] * (1 + len(text) % 3),
        "error": None,
    }


def deadly(task):
    """`record_of`, but the file `poison` kills its worker.

    `begun` in its folder has a line for every recording that was begun.
    """
    begun = task.path.with_name("begun")
    with begun.open("a") as file:
        file.write(f"{task.recording}\n")
    if task.recording == "poison":
        os.kill(os.getpid(), signal.SIGKILL)
    return record_of(task)


def evaluate_or_sleep(task):
    if task.recording.endswith("zz.bin"):
        time.sleep(3600)
    return evaluate_recording(task)
