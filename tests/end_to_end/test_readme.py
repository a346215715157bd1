"""Every command of the README and of docs/reproduction.md, as it stands there. The first two set
a machine up: .ci/run runs those; this runs the others, with a scratch folder for /tmp and the
current folder.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from drivers.session_log import SessionLog
from tests.bridge.mosquitto import Broker, Subscriber
from tests.end_to_end.peers import WAIT, wait_for
from tests.training.cmu_site import serving

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()
REPRODUCTION = (ROOT / "docs/reproduction.md").read_text()
BLOCKS = [block.strip() for block in re.findall(r"```sh\n(.*?)```", README, flags=re.DOTALL)]
LIVE = 3.0  # s that a session which would not end is watched


def block(words: str) -> str:
    (found,) = [text for text in BLOCKS if words in text]
    return found


SIMULATE = block("performer:walk --to serial")
SESSION = block("take.c3d")
REPLAY = block("simulate c3d:captures/walk.c3d")
ENGINE = block("vmc://")
MANY = block("mqtt://")
TWO = block("--performers ann,bob")
BOTH = block("?performers=ann,bob")
TROUBLE = block("markerbridge doctor")
MODEL = block("markerbridge train")
FETCH = block("markerbridge fetch")
CALIBRATE = block("markerbridge calibrate")
VIEW = block("markerbridge view")


def test_no_command_of_the_readme_is_left_out() -> None:
    run = {SIMULATE, SESSION, TROUBLE, VIEW, REPLAY, ENGINE, MANY, TWO, BOTH}
    assert set(BLOCKS[2:]) == run | {CALIBRATE, MODEL, FETCH}
    for setting_up in BLOCKS[:2]:
        assert "apt-get install" in setting_up
        assert "pip install -c requirements.lock" in setting_up


@contextmanager
def shell(command: str, cwd: Path) -> Iterator[subprocess.Popen[str]]:
    """The command in a shell of its own, as at a prompt."""
    here = Path(sys.executable).parent
    assert (here / "markerbridge").exists(), "install the package: pip install ."
    process = subprocess.Popen(
        ["bash", "-c", command.replace("/tmp/", f"{cwd}/")],
        cwd=cwd,
        env=os.environ | {"PATH": f"{here}:{os.environ['PATH']}", "NO_PROXY": "127.0.0.1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def interrupted(process: subprocess.Popen[str]) -> str:
    """Ctrl-C: what it printed; it ends well."""
    os.killpg(process.pid, signal.SIGINT)
    output, _ = process.communicate(timeout=WAIT)
    assert process.returncode == 0, output
    assert "Traceback" not in output
    return output


def finished(process: subprocess.Popen[str], timeout: float = WAIT) -> str:
    output, _ = process.communicate(timeout=timeout)
    assert process.returncode == 0, output
    assert "Traceback" not in output
    return output


@pytest.mark.parametrize("command", [SESSION, ENGINE], ids=["session", "engine"])
def test_a_live_session_with_the_simulated_tracker(command: str, tmp_path: Path) -> None:
    with shell(SIMULATE, tmp_path) as device:
        wait_for((tmp_path / "tracker").is_symlink, "the serial port")
        with shell(command, tmp_path) as bridge:
            time.sleep(LIVE)  # real processes in real time
            output = interrupted(bridge)
        assert "poses out" in output
        frames = int(re.search(r"poses out: (\d+)", output)[1])
        assert frames > 60
        interrupted(device)
    if command == SESSION:
        assert (tmp_path / "take.c3d").stat().st_size > 10_000


def test_a_session_looked_into_recorded_and_played_again(data_dir: Path, tmp_path: Path) -> None:
    with shell(SIMULATE, tmp_path):
        wait_for((tmp_path / "tracker").is_symlink, "the serial port")
        with shell(f"set -e\n{TROUBLE}", tmp_path) as commands:
            output = finished(commands, 90)
    assert f"serial:{tmp_path}/tracker" in output
    assert (tmp_path / "again.c3d").stat().st_size > 100_000
    assert len((tmp_path / "session.csv").read_text().splitlines()) > 300

    # What was recorded is looked at as well; tests have no display for its window.
    recording, capture = VIEW.splitlines()
    (tmp_path / "captures").mkdir()
    shutil.copy(data_dir / "real/02_03.c3d", tmp_path / "captures/walk.c3d")
    shorter = "--seconds 1 --size 320x180 --fps 5"
    with shell(f"set -e\n{recording} --png view.png\n{capture} {shorter}", tmp_path) as viewing:
        finished(viewing, 60)
    assert (tmp_path / "view.png").stat().st_size > 10_000
    assert (tmp_path / "walk.gif").stat().st_size > 10_000


def test_poses_by_a_broker(tmp_path: Path) -> None:
    with (
        Broker(tmp_path) as broker,
        Subscriber(broker, "stage/pose") as reader,
        shell(SIMULATE, tmp_path),
    ):
        wait_for((tmp_path / "tracker").is_symlink, "the serial port")
        command = MANY.replace("mqtt://127.0.0.1", f"mqtt://127.0.0.1:{broker.port}")
        with shell(command, tmp_path) as bridge:
            for _ in range(100):
                reader.next()
            assert "poses out" in interrupted(bridge)


def test_several_performers(tmp_path: Path) -> None:
    recordings = [tmp_path / f"stage-{name}.mcap" for name in ("ann", "bob")]
    with shell(TWO, tmp_path), shell(BOTH, tmp_path) as bridge:
        for path in recordings:
            wait_for(lambda path=path: path.exists() and path.stat().st_size > 100_000, path.name)
        output = interrupted(bridge)
    assert "ann to osc://127.0.0.1:9200" in output
    for path in recordings:
        assert len(list(SessionLog(path).poses())) > 60


def test_a_replay_with_its_summary(data_dir: Path, tmp_path: Path) -> None:
    (tmp_path / "captures").mkdir()
    shutil.copy(data_dir / "real/07_12.c3d", tmp_path / "captures/walk.c3d")
    with shell(REPLAY, tmp_path) as replay:
        output = finished(replay)
    summary = json.loads(next(line for line in output.splitlines() if line.startswith("{")))
    assert summary["frames"] == 263
    assert 10 < summary["rms_mm"] < 200
    assert (tmp_path / "out.c3d").exists()


@pytest.mark.timeout(400)
def test_a_model_of_ones_own(data_dir: Path, tmp_path: Path) -> None:
    (tmp_path / "captures").mkdir()
    for name in ("02_01", "07_01", "16_07"):
        shutil.copy(data_dir / f"real/{name}.c3d", tmp_path / "captures")
    train, evaluate, run = MODEL.splitlines()
    with shell(train, tmp_path) as training:
        finished(training, 300)
    with shell(evaluate, tmp_path) as evaluation:
        finished(evaluation, 100)
    assert '"rms_ratio"' in (tmp_path / "figures.json").read_text()
    assert "Beside the paper" in (tmp_path / "report/index.html").read_text()
    with shell(SIMULATE, tmp_path):
        wait_for((tmp_path / "tracker").is_symlink, "the serial port")
        with shell(run, tmp_path) as bridge:
            time.sleep(LIVE)
            assert "poses out" in interrupted(bridge)


def test_a_person_of_ones_own(data_dir: Path, tmp_path: Path) -> None:
    (tmp_path / "captures").mkdir()
    shutil.copy(data_dir / "real/02_05.c3d", tmp_path / "captures/me.c3d")
    with shell(CALIBRATE, tmp_path) as calibration:
        assert "calibrated" in finished(calibration, 60)
    with shell(SIMULATE.replace("simulate", "simulate --model me.onnx"), tmp_path):
        wait_for((tmp_path / "tracker").is_symlink, "the serial port")
        with shell("markerbridge run serial:/tmp/tracker --model me.onnx", tmp_path) as run:
            time.sleep(LIVE)
            assert "poses out" in interrupted(run)


def test_captures_from_the_database(data_dir: Path, tmp_path: Path) -> None:
    """From a server here that is laid out as the database's site: it is not asked by tests."""
    with serving(data_dir) as site, shell(f"{FETCH} --from {site.url}", tmp_path) as fetching:
        finished(fetching)
    captures = {path.name for path in (tmp_path / "captures").glob("*/*.c3d")}
    assert captures == {"02_01.c3d", "02_02.c3d", "02_03.c3d", "07_12.c3d"}
    assert "brisk walk" in (tmp_path / "captures/manifest.csv").read_text()


COMMANDS = re.findall(r"```sh\n(.*?)```", REPRODUCTION, flags=re.DOTALL)


@pytest.mark.timeout(400)
def test_the_papers_experiments(small_dir: Path, tmp_path: Path) -> None:
    """As docs/reproduction.md has them, but on few captures and with few runs."""
    (tmp_path / "captures").symlink_to(small_dir)
    commands = "".join(COMMANDS).replace("--runs 1000", "--runs 12")
    with shell(f"set -e\n{commands}", tmp_path) as experiments:
        finished(experiments, 350)
    pages = sorted(page.parent.name for page in (tmp_path / "reports").glob("*/index.html"))
    assert pages == ["evaluate", "evaluate-paper", "markers", "train", "train-paper"]
