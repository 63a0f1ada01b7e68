"""A stream in the Rerun viewer: its events, volumes, landmark, probabilities and decisions.

    with RerunView("digits", out="seven.rrd") as view:
        for packet in open_recording("seven.bin"):
            view.push(packet)

With a model of raw outputs, it shows these in place of probabilities and decisions.

Needs the extra `view`. `rerun_log`, `rerun_decisions` and `rerun_outputs` have the names under
which data is logged. The modules `figure_...` draw the figures of `async-tnt plot`, and
`output_pictures` says how raw outputs become pictures in both.
"""

from async_tnt.views.rerun_view import RerunView

__all__ = ["RerunView"]
