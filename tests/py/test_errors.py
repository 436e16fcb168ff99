"""Errors: text, class by code, and survival of process boundaries."""

import pickle

import pytest

from gnssins import _core, errors
from gnssins.errors import GnssinsError, MissingFileError, from_core


def test_text_is_class_code_message_and_hint():
    error = errors.TimeOrderError("time.backwards", "imu.csv row 3: t = 1 s after 2 s", "sort the file")
    assert str(error) == (
        "TimeOrderError [time.backwards] imu.csv row 3: t = 1 s after 2 s\n  hint: sort the file"
    )


def test_text_without_hint_is_one_line():
    assert str(errors.StateError("state.saved", "wrong layout")) == "StateError [state.saved] wrong layout"


@pytest.mark.parametrize(
    ("code", "kind"),
    [
        ("config.range", errors.ConfigError),
        ("input.column", errors.InputError),
        ("time.backwards", errors.TimeOrderError),
        ("gap.imu", errors.GapError),
        ("cov.not_positive_definite", errors.CovarianceError),
        ("data.accel_unit", errors.DataQualityError),
        ("state.saved", errors.StateError),
        ("nav.latitude", errors.NavigationError),
    ],
)
def test_first_word_of_the_code_picks_the_class(code, kind):
    error = from_core(code, "what", "remedy", {"row": 7})
    assert type(error) is kind
    assert (error.code, error.hint, error.context) == (code, "remedy", {"row": 7})


def test_unknown_family_gives_the_base_class_not_a_second_failure():
    assert type(from_core("later.thing", "what")) is GnssinsError


def test_every_error_is_one_family():
    for name in errors.__all__:
        member = getattr(errors, name)
        if isinstance(member, type):
            assert issubclass(member, GnssinsError)


def test_missing_file_is_also_the_built_in_error():
    error = MissingFileError("input.not_found", "a.csv: no such file", context={"file": "a.csv"})
    assert isinstance(error, FileNotFoundError)
    assert error.filename == "a.csv"
    assert str(error) == "MissingFileError [input.not_found] a.csv: no such file"


@pytest.mark.parametrize("kind", [errors.GapError, MissingFileError])
def test_error_crosses_a_process_boundary_whole(kind):
    error = pickle.loads(pickle.dumps(kind("input.x", "message", "hint", {"row": 1, "file": "f"})))
    assert type(error) is kind
    assert (error.code, error.message, error.hint) == ("input.x", "message", "hint")
    assert error.context == {"row": 1, "file": "f"}


def test_compiled_core_raises_the_same_classes():
    with pytest.raises(errors.ConfigError, match=r"\[config.preset\].*ned-99") as caught:
        _core.preset_json("ned-99")
    assert caught.value.hint
