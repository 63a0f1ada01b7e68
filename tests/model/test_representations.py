"""What a model, its compiled form and a decision say of themselves: one short line, and a table in notebooks."""

import re
from html.parser import HTMLParser

import pytest
from model.small import SMALL, WITH_REGRESSOR, changed, small_model

from async_tnt import CompiledClassifier, Model, Processor
from async_tnt.decision import html_table

NASTY = ("<script>alert(1)</script>", "a\n\x1b[31mb", "</td>&\"'")


class Texts(HTMLParser):
    """What a browser shows, and the elements it makes."""

    def __init__(self, source):
        super().__init__()
        self.tags, self.text = set(), ""
        self.feed(source)

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)

    def handle_data(self, data):
        self.text += data + "|"


@pytest.mark.parametrize(
    "value, line",
    [
        (small_model(), "Model(3 classes, 9x8 -> 2x6x5, 2 conv, 2 dense, 126 weights)"),
        (small_model(config=WITH_REGRESSOR), "Model(3 classes, 9x8 -> 2x6x5, 6 conv, 2 dense, 889 weights)"),
        (
            Model(SMALL, changed(), NASTY, {"network": NASTY}),
            "Model(3 classes, 9x8 -> 2x6x5, 2 conv, 2 dense, 126 weights)",
        ),
        (CompiledClassifier(small_model()), "CompiledClassifier(2x6x5 -> 3 logits, 6 steps, 1,104 products)"),
    ],
)
def test_one_line(value, line):
    assert repr(value) == line


def test_tables_show_any_name_as_it_is():
    model = Model(SMALL, changed(), NASTY)
    table = Texts(model._repr_html_())
    assert table.tags == {"table", "tr", "th", "td"}
    assert table.text == f"Model|9x8 -> 2x6x5|network|2 conv, 2 dense, 126 weights|3 classes|{', '.join(NASTY)}|"
    for k, name in enumerate(NASTY):
        logits = [5.0 * (k == j) for j in range(3)]
        decision = Processor(
            SMALL, classifier=lambda volume, logits=logits: logits, classes=NASTY, start_us=12_345
        ).fire()
        table = Texts(decision._repr_html_())
        assert table.tags == {"table", "tr", "th", "td", "meter"}
        assert table.text == f"{name}| 98.7%|time|12.345 ms, window from 12.345 ms on|events|0|trigger|fire|"
        assert re.search(r'<meter value="0\.9867">', decision._repr_html_())


def test_a_table_of_many_names_stays_short():
    assert len(html_table({"<" * 10**6: ", ".join(map(str, range(10**6)))})) < 2000
