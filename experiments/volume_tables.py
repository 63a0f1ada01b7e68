"""The tables of event volumes, from bench.json and peers.json, and of memory."""

from __future__ import annotations

from typing import Any

from experiments.page_parts import results, short, table

PEERS = {
    "eventcv": "eventcv",
    "tonic": "tonic",
    "dsec_torch": "DSEC's method in torch",
    "torch_scatter": "torch with the transform, one `scatter_add_`",
}


def volumes() -> str:
    """Nanoseconds per event, by the size of a packet."""
    ways = {
        "single": "`update_one`",
        "packet_10_columns": "packets of 10, columns",
        "packet_1300_columns": "packets of 1300, columns",
        "packet_1300_structured": "packets of 1300, structured",
    }
    grids = results("bench")["volume"]
    rows = [
        [f"ns per event, {words}", *(short(v["ns_per_event"][way]["median"]) for v in grids)]
        for way, words in ways.items()
    ]
    return table(["", *("{} x {}".format(*v["grid"]) for v in grids)], rows)


def large_packets() -> str:
    """A new window's volume of one large packet: peers relative to async_tnt."""
    large = [r for r in results("peers")["results"] if r["events_a_packet"] != 1300]
    head = ["one packet", *("{} x {}, ".format(*r["grid"]) + f"{r['events_a_packet']:,} events" for r in large)]
    rows = [
        [f"{peer} / async_tnt", *(short(r["rows"][name]["times_ours_fresh"]) for r in large)]
        for name, peer in PEERS.items()
    ]
    return table(head, rows)


def splat() -> str:
    """Events into a volume, beside the peers: packets of 1300 and whole windows."""
    found = _by_packet()
    head = ["", *found]
    ours = {"ours_update": "async_tnt", "ours_update_read": "async_tnt, volume read after each packet"}
    rows = [
        [f"{words}, ns an event", *(short(rows[name]["ns_per_event"]["median"]) for rows in found.values())]
        for name, words in ours.items()
    ]
    for name, words in PEERS.items():
        cells = []
        for rows_of in found.values():
            theirs = rows_of[name]
            to_update = theirs["ns_per_event"]["median"] / rows_of["ours_update"]["ns_per_event"]["median"]
            cells.append(f"{short(to_update)} / {short(theirs['times_ours_update_read'])}")
        rows.append([f"{words}: ratio / ratio to the volume read", *cells])
    return table(head, rows)


def _by_packet() -> dict[str, dict[str, Any]]:
    return {
        "{} x {}".format(*r["grid"]) + f", packets of {r['events_a_packet']:,}": r["rows"]
        for r in results("peers")["results"]
    }


def memory() -> str:
    """A sentence."""
    found = results("memory")
    return (
        f"After {found['events'] / 1e6:.0f} million events and {found['decisions']:,} decisions the process has grown "
        f"by {found['grown_mb']:.1f} MB since the first million. `experiments/memory.py` exits with 1 above "
        f"{found['limit_mb']:g} MB."
    )
