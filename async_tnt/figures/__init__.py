"""Draw what happens to the events of a recording. Needs the extra `plot` (matplotlib).

`subject` holds what is drawn, `coordinates` says where the transform puts each event; `events3d`, `slices`,
`probabilities`, `motions`, `pipeline` and `overview` draw a figure each, in the colours of `style`; `command` is
`async-tnt plot`. matplotlib is imported only when something is drawn.
"""
