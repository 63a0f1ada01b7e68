"""Errors of a source name it first."""

from async_tnt.sources.files.source_error import SourceError


def test_a_source_error_begins_with_the_source_and_names_parameters_as_asked():
    error = SourceError("", "choose one by {topic}").of("a.bag", "not readable: ")
    assert str(error) == "a.bag: not readable: choose one by `topic`"
    assert error.text({"topic": "--topic"}) == "a.bag: not readable: choose one by --topic"
