from __future__ import annotations

import re
from pathlib import Path

import pytest

from bridge.session_file import LogPlan, SessionPlan, plan_session, read_session
from bridge.sinks.registry import SINKS
from drivers.errors import UsageError
from drivers.registry import SOURCES, open_source
from drivers.url import Url

DOCUMENT = (Path(__file__).parents[2] / "docs/session.md").read_text()
EXAMPLE = re.findall(r"```toml\n(.*?)```", DOCUMENT, flags=re.DOTALL)[0]


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "session.toml"


def read(file: Path, text: str) -> SessionPlan:
    file.write_text(text)
    return read_session(file)


def test_a_session_file_of_one_line_is_enough(file: Path) -> None:
    plan = read(file, 'source = "serial:/dev/ttyUSB0"')
    assert plan.source[0].address == "serial:/dev/ttyUSB0"
    assert plan.model_dump() == plan_session({"source": plan.source[0].url}).model_dump()
    assert (plan.model, plan.sinks, plan.wait, plan.seconds) == ("default", [], False, None)
    assert plan.folder == file.parent


def test_what_a_source_table_says_are_the_options_of_its_address(file: Path) -> None:
    plan = read(
        file,
        """
        [source]
        url = "osc://127.0.0.1:0?dialect=native"
        axes = ["x", "-z", "y"]
        unit = "cm"
        reorder = 2
        labels = { Hand_L = "LWRB", "the & other=hand" = "RWRB" }
        """,
    )
    url = Url.parse(plan.source[0].address)
    assert url.options == {
        "dialect": "native",
        "axes": "x,-z,y",
        "unit": "cm",
        "reorder": "2",
        "labels": "Hand_L:LWRB,the & other=hand:RWRB",
    }
    with open_source(plan.source[0].address) as source:
        assert source.name == plan.source[0].address


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("\n\nsource = \n", ", line 3: no TOML: Invalid value"),
        ('source = "c3d:x', ", line 1: no TOML: Unterminated string"),
        ("", ": source: it is missing"),
        ("source = 3", ", line 1: source: it is an address, or a table with a url and its options"),
        ("[source]\nframe = 'unity'", ", line 1: source.url: it is missing"),
        ("[source]\nurl = 7", ', line 2: source.url: it is text: write it in "quotes"'),
        (
            "[source]\nurl = 'c3d:x'\nallow = []",
            ", line 3: source.allow: it is empty: leave it out",
        ),
        (
            "[source]\nurl = 'c3d:x'\nlabels = { Hand = 'a,b' }",
            ", line 3: source.labels: 'a,b' is no text without a comma",
        ),
        ("source = 'c3d:x'\nsauce = 1", ", line 2: sauce: unknown key (known: source, model, "),
        (
            "source = 'c3d:x'\n[log]\nlevle = 1",
            ", line 3: log.levle: unknown key (known: level, every, lines)",
        ),
        ("source = 'c3d:x'\nlog.level = 'loud'", ", line 2: log.level: known are 'debug', 'info'"),
        ("source = 'c3d:x'\nlog.every = '3'", ", line 2: log.every: it is a number"),
        ("source = 'c3d:x'\nlog = 3", ", line 2: log: it is a table"),
        ("source = 'c3d:x'\nsinks = 'view:'", ', line 2: sinks: it is a list: ["...", "..."]'),
        (
            "source = 'c3d:x'\nsinks = [\n  'view:',\n  3\n]",
            ', line 4: sinks: it is text: write it in "quotes"',
        ),
        ("source = 'c3d:x'\nsinks = ['a:b', 'a:b']", ", line 2: sinks: a sink is named twice"),
        ("source = 'c3d:x'\nseconds = 0", ", line 2: seconds: it is a number above 0"),
        ("source = 'c3d:x'\nseconds = inf", ", line 2: seconds: it is a number"),
        ("source = 'c3d:x'\nwait = 'yes'", ", line 2: wait: it is true or false"),
        ("source = 'c3d:x'\nstatus = 'here'", ", line 2: status: 'here' is no address: write HOST"),
        ("source = 'c3d:x'\nstatus = true", ", line 2: status: 'True' is no address: write HOST"),
        ("x = " + "[" * 10_000, ": no session file: nested too deeply"),
        ("#" * 100_000, ": no session file: it is larger than 64 KiB"),
    ],
)
def test_what_is_wrong_is_named_by_file_line_and_key(file: Path, text: str, words: str) -> None:
    with pytest.raises(UsageError) as caught:
        read(file, text)
    assert str(caught.value).startswith(f"{file}{words}")
    assert "\n" not in str(caught.value)


def test_what_is_no_text_or_not_there_is_named(tmp_path: Path, file: Path) -> None:
    file.write_bytes(b"# a\n# \xff\n")
    with pytest.raises(UsageError, match=r"session\.toml, line 2: no text \(UTF-8\)"):
        read_session(file)
    with pytest.raises(UsageError, match=r"absent\.toml: cannot read .*: No such file"):
        read_session(tmp_path / "absent.toml")
    with pytest.raises(UsageError, match="cannot read the session file: Is a directory"):
        read_session(tmp_path)


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("'osc://127.0.0.1:x'", ", line 2: source: 'osc://127.0.0.1:x': write HOST:PORT, "),
        ("'osc://127.0.0.1:0?frmae=1'", ", line 2: source: 'osc://127.0.0.1:0?frmae=1': unknown"),
        ("'morse:x'", ", line 2: source: 'morse:x' is no source: known are "),
        ("{ url = 'morse:x', unit = 'm' }", ", line 2: source: 'morse:x?unit=m' is no source"),
        (
            "{ url = 'osc://127.0.0.1:0', frmae = 'unity' }",
            ", line 2: source.frmae: unknown key (known: dialect, ",
        ),
        (
            "{ url = 'osc://127.0.0.1:0', frame = 'unty' }",
            ", line 2: source.frame: 'unty': known are cmu, ",
        ),
        (
            "{ url = 'osc://127.0.0.1:0?unit=m', unit = 'm' }",
            ", line 2: source.unit: 'osc://127.0.0.1:0?unit=m' has it",
        ),
    ],
)
def test_an_address_that_is_wrong_is_named_by_its_line(file: Path, source: str, words: str) -> None:
    plan = read(file, f"# mine\nsource = {source}")
    with pytest.raises(UsageError) as caught, plan.naming("source"):
        open_source(plan.source[0].address)
    assert str(caught.value).startswith(f"{file}{words}")


def test_an_address_of_the_command_line_is_named_as_it_is() -> None:
    plan = plan_session({"source": "morse:x"})
    assert plan.folder is None
    with pytest.raises(UsageError, match=r"^'morse:x' is no source"), plan.naming("source"):
        open_source(plan.source[0].address)


def test_the_documented_example_has_every_key_and_its_source_opens(file: Path) -> None:
    plan = read(file, EXAMPLE)
    assert plan.model_fields_set == set(SessionPlan.model_fields)
    assert plan.log.model_fields_set == set(LogPlan.model_fields)
    assert Url.parse(plan.source[0].url).scheme in SOURCES
    assert {Url.parse(sink).scheme for sink in plan.sinks} <= set(SINKS)
    free = plan.source[0].address.replace("0.0.0.0:9100", "127.0.0.1:0")
    with open_source(free) as source:
        assert source.name == free


def test_options_are_added_to_an_address_once() -> None:
    added = Url.parse("osc://127.0.0.1:9?a=1").adding({"allow": "10.0.0.0/8,::1", "b": "x y&z"})
    assert added.text == "osc://127.0.0.1:9?a=1&allow=10.0.0.0/8,::1&b=x%20y%26z"
    assert added.options == {"a": "1", "allow": "10.0.0.0/8,::1", "b": "x y&z"}
    assert Url.parse("c3d:x").adding({}).text == "c3d:x"
    with pytest.raises(UsageError, match="option a is given twice"):
        Url.parse("c3d:x?a=1").adding({"a": "2"})


def test_an_option_with_nothing_behind_it_is_not_left_out_quietly() -> None:
    with pytest.raises(UsageError, match="option unit= is wrong"):
        open_source("osc://127.0.0.1:0?unit=")
