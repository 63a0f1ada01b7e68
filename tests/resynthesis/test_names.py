"""Names that were public in version 0.2 say where they are now."""

import pytest

import async_tnt.resynthesis
import async_tnt.simulation


@pytest.mark.parametrize(
    "name",
    [
        "Calibration",
        "MotionPath",
        "MovedImage",
        "Reconstruction",
        "SimulatedPixels",
        "calibrate",
    ],
)
def test_a_name_of_resynthesis_says_where_it_is(name):
    place = r"async_tnt\.resynthesis\.(calibration|paths|reconstruction) has it"
    with pytest.raises(AttributeError, match=f"{name} is no longer public: .*, and {place}"):
        getattr(async_tnt.resynthesis, name)


@pytest.mark.parametrize("name", ["Picture", "SceneSettings", "record_picture"])
def test_a_name_of_simulation_says_where_it_is(name):
    place = r"async_tnt\.simulation\.(pictures|picture_scene) has it"
    with pytest.raises(AttributeError, match=f"{name} is no longer public: .*, and {place}"):
        getattr(async_tnt.simulation, name)


@pytest.mark.parametrize("package", [async_tnt.resynthesis, async_tnt.simulation])
def test_a_name_that_never_was_is_an_ordinary_error(package):
    with pytest.raises(AttributeError, match="has no attribute 'never'"):
        package.never  # noqa: B018
