"""USD's errors and warnings, as ours."""

import pytest
from pxr import Tf

from cageik_cli.formats.usd.library import capture_diagnostics
from cageik_cli.util.errors import InputError


def test_warnings_are_kept_without_folders_and_addresses(capfd):
    with capture_diagnostics(InputError) as warnings:
        Tf.Warn("Could not load @/home/me/a.usda@\n (Opening stage on stage @/b@ <0x7f>)")
        assert warnings == []
    assert warnings == ["USD warns: Could not load a.usda"]
    assert capfd.readouterr().err == ""


def test_errors_become_the_given_one(capfd):
    with pytest.raises(InputError) as caught, capture_diagnostics(InputError):
        Tf.RaiseRuntimeError("@/x/a.usda@:1: parse error matching pxrInternal::Rule at 'x'")
    assert str(caught.value) == "Python runtime error: a.usda:1: parse error at 'x'"
    assert capfd.readouterr().err == ""


def test_warnings_before_an_error_are_not_printed(capfd):
    def warn_and_fail():
        Tf.Warn("first")
        Tf.RaiseRuntimeError("then")

    with pytest.raises(InputError), capture_diagnostics(InputError):
        warn_and_fail()
    assert capfd.readouterr().err == ""


def test_names_that_are_not_text_are_an_error_too():
    with pytest.raises(InputError, match="its text is not UTF-8"), capture_diagnostics(InputError):
        b"\xb8".decode()


def test_other_errors_pass():
    with pytest.raises(KeyError), capture_diagnostics(InputError):
        raise KeyError
