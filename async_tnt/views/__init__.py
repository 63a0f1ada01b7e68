"""A stream in the Rerun viewer: its events, volumes, landmark, probabilities and decisions.

    with RerunView("digits", out="seven.rrd") as view:
        for packet in open_recording("seven.bin"):
            view.push(packet)

Needs the extra `view`. The names of what is logged are in `rerun_log`. The figures of `async-tnt
plot` are in the modules `figure_...`.
"""

from async_tnt.views.rerun_view import RerunView

__all__ = ["RerunView"]
