"""What a stream looks like in the Rerun viewer: events, volumes, landmark, probabilities and decisions.

    with RerunView("digits", out="seven.rrd") as view:
        for packet in open_recording("seven.bin"):
            view.push(packet)

Needs the extra `view`. What is logged, and under which names, is in `layout`.
"""

from async_tnt.views.rerun_view import RerunView

__all__ = ["RerunView"]
