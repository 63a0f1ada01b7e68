"""A stream in the Rerun viewer: its events, volumes, landmark, probabilities and decisions.

    with RerunView("digits", out="seven.rrd") as view:
        for packet in open_recording("seven.bin"):
            view.push(packet)

Needs the extra `view`. `rerun_log` has the names under which data is logged. The modules
`figure_...` draw the figures of `async-tnt plot`.
"""

from async_tnt.views.rerun_view import RerunView

__all__ = ["RerunView"]
