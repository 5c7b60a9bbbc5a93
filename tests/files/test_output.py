"""Commands write new files and in their own folders only; what others have written stays as it was."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from hrl_comfort.cli.main import main
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, EvaluateConfig
from hrl_comfort.config.overrides import at_home
from hrl_comfort.files.atomic import all_or_none, write_text
from hrl_comfort.files.output import output_file, output_folder
from hrl_comfort.files.run_config import save_config
from hrl_comfort.files.run_folder import find_runs

EVALUATE = ("evaluate", "policy=random", "episodes=1", "task=reach", "human=none")
TRAIN = ("train", "task=reach", "agent.policy_steps=16", "agent.learning_starts=8", "agent.hidden=[4]")
BENCH = ("bench", "env")
FIGURE = ("figure", "kind=levels", "evaluations=[.]")


def foreign(folder: Path) -> None:
    for name in ("video.mp4", "config.yaml", "episodes.csv", "metrics.csv", "env.csv"):
        (folder / name).write_text("mine")


def notes(folder: Path) -> None:
    (folder / "notes.txt").write_text("mine")


def training(folder: Path) -> None:
    save_config(compose("train"), folder / "config.yaml")


def evaluation(folder: Path) -> None:
    save_config(compose("evaluate"), folder / "config.yaml")
    (folder / "summary.json").write_text("{}")


def job(folder: Path) -> None:
    (folder / "job.json").write_text("[]")


def tree(folder: Path) -> dict[str, bytes | str]:
    """Return every entry of a folder: the content of files, the target of links, the mode of others."""

    def content(path: Path) -> bytes | str:
        if path.is_symlink():
            return os.readlink(path)
        return path.read_bytes() if path.is_file() else str(path.lstat().st_mode)

    return {str(path.relative_to(folder)): content(path) for path in sorted(folder.rglob("*"))}


def refused(words: tuple[str, ...], capsys: pytest.CaptureFixture[str], root: Path) -> str:
    """Run a command that must change nothing in `root`; return its line."""
    before = tree(root)
    assert main(list(words)) == 1
    assert tree(root) == before
    line = capsys.readouterr().err
    assert len(line.splitlines()) == 1
    return line


@pytest.mark.parametrize("words", [EVALUATE, TRAIN, ("train", "hierarchy"), ("evaluate", "-m", *EVALUATE[1:])])
@pytest.mark.parametrize("fill", [foreign, notes, training, evaluation, job])
def test_no_command_writes_in_a_folder_of_something_else(
    words: tuple[str, ...], fill: Callable[[Path], None], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own = training if words[0] == "train" else evaluation
    folder = tmp_path / "0"
    folder.mkdir()
    fill(folder)
    swept = "-m" in words
    if fill is own:
        return
    if swept:
        before = tree(folder)
        assert main([*words, "hydra.launcher.n_jobs=1", "episode_seed=1000000", f"output={tmp_path}"]) == 1
        assert tree(folder) == before
    else:
        assert "--overwrite" in refused((*words, f"output={folder}"), capsys, tmp_path)


@pytest.mark.parametrize("words", [BENCH, FIGURE, (*EVALUATE, "terminal_states=TARGET")])
@pytest.mark.parametrize("kind", ["file", "fifo", "link", "loop", "folder"])
def test_a_file_is_replaced_only_if_the_program_wrote_it(
    words: tuple[str, ...], kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = {"bench": "env.csv", "figure": "x.png", "evaluate": "x.npz"}[words[0]]
    path = tmp_path / target
    if kind == "file":
        path.write_text("mine")
    elif kind == "fifo":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    else:
        path.symlink_to(tmp_path / "there" if kind == "link" else path)
        (tmp_path / "there").write_text("mine")
    output = tmp_path if words[0] == "bench" else path
    words = tuple(word.replace("TARGET", str(path)) for word in words)
    refused(words if words[0] == "evaluate" else (*words, f"output={output}"), capsys, tmp_path)


@pytest.mark.parametrize("kind", ["file", "fifo", "link"])
def test_a_sweep_replaces_no_record_but_that_of_a_sweep(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record = tmp_path / "multirun.yaml"
    if kind == "fifo":
        os.mkfifo(record)
    else:
        (tmp_path / "there").write_text("a: 1")
        record.symlink_to("there") if kind == "link" else record.write_text("a: 1")
    refused((*EVALUATE[:1], "-m", *EVALUATE[1:], "hydra.launcher.n_jobs=1", f"output={tmp_path}"), capsys, tmp_path)


@pytest.mark.skipif(os.getuid() != 0, reason="only root can replace devices")
def test_a_device_stays_a_device(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    null = tmp_path / "null.png"
    os.mknod(null, 0o020666, os.makedev(1, 3))
    refused((*FIGURE, f"output={null}"), capsys, tmp_path)
    with pytest.raises(OSError, match="not a regular file"):
        write_text(null, "text")


@pytest.mark.parametrize("name", ["/", ".", ""])
def test_a_folder_is_no_page(name: str) -> None:
    with pytest.raises(ConfigError, match="is a folder; give the name of a file"):
        output_file(Path(name), ".csv").__enter__()


def test_insisting_writes_among_other_files_and_touches_no_other_name(tmp_path: Path) -> None:
    foreign(tmp_path)
    notes(tmp_path)
    assert main([*EVALUATE, f"output={tmp_path}", "--overwrite"]) == 0
    assert (tmp_path / "notes.txt").read_text() == "mine"
    assert (tmp_path / "config.yaml").read_text() != "mine"
    assert main([*EVALUATE, f"output={tmp_path}"]) == 0, "it is an evaluation's folder now"


def test_a_link_on_the_way_leads_to_the_folder_it_names(tmp_path: Path) -> None:
    (tmp_path / "far").mkdir()
    (tmp_path / "near").symlink_to("far")
    with output_folder(tmp_path / "near" / "run", EvaluateConfig):
        write_text(tmp_path / "near" / "run" / "a", "text")
    assert (tmp_path / "far" / "run" / "a").read_text() == "text"


def test_one_process_writes_a_folder_or_a_file_at_a_time(tmp_path: Path) -> None:
    with output_folder(tmp_path / "run", EvaluateConfig), pytest.raises(ConfigError, match="in use"):
        output_folder(tmp_path / "run", EvaluateConfig).__enter__()
    page = tmp_path / "page.html"
    with output_file(page):
        for _ in range(2):
            with pytest.raises(ConfigError, match="in use"):
                output_file(page).__enter__()
    with output_file(page):
        pass
    assert not list(tmp_path.iterdir()), "neither locks nor empty folders stay"


def write_both(*paths: Path) -> None:
    for path in paths:
        write_text(path, "new")


@pytest.mark.parametrize("number", [errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP])
def test_a_file_system_without_locks_is_warned_of_and_written(
    number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def flock(*_: int) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr("hrl_comfort.files.output.fcntl.flock", flock)
    with pytest.warns(UserWarning, match="run: its file system has no locks"), output_folder(tmp_path / "run", object):
        (tmp_path / "run" / "done").touch()
    with pytest.warns(UserWarning, match="page: its file system has no locks"), output_file(tmp_path / "page"):
        write_text(tmp_path / "page", "whole")
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["done", "page", "run"]


@pytest.mark.parametrize("given", ["output=~/x", "output='~/x'", 'output="~/x"'])
def test_a_path_in_the_home_folder_is_there(
    given: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    assert main(["train", "task=reach", given, "--dry-run"]) == 0
    assert f"output: {tmp_path}/x\n" in capsys.readouterr().out


def test_only_values_begin_in_the_home_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/home/me")
    assert at_home("evaluations=[~/a,'~/b',c~/d]") == "evaluations=[/home/me/a,'/home/me/b',c~/d]"
    assert at_home("policy=sb3:~/a,~") == "policy=sb3:/home/me/a,/home/me"
    for line in ("~human.mixture.approach", "output=a~", "output=~me/x", "x=a/~/b", "hierarchy.controller=['~a.b']"):
        assert at_home(line) == line


def test_files_that_belong_together_appear_together_or_not_at_all(tmp_path: Path) -> None:
    paths = [tmp_path / name for name in "abc"]
    for path in paths:
        path.write_text("old")
    with pytest.raises(OSError, match="not a regular file"), all_or_none(paths[2]):
        write_both(paths[0], tmp_path)
    assert tree(tmp_path) == dict.fromkeys("abc", b"old")
    with all_or_none(paths[2]):
        write_both(paths[0], tmp_path / "d")
        assert paths[0].read_text() == "old"
    assert tree(tmp_path) == {"a": b"new", "b": b"old", "d": b"new"}


def test_a_full_disk_leaves_the_evaluation_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    words = [*EVALUATE, f"output={tmp_path / 'eval'}"]
    assert main([*words, "record=true"]) == 0
    before = tree(tmp_path)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("hrl_comfort.evaluation.rollout.write_json", full)
    assert main(words) == 1
    assert tree(tmp_path) == before


def test_a_hidden_folder_is_no_run(tmp_path: Path) -> None:
    for name in ("b", ".trash", "a"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "episodes.csv").write_text("episode,success\n0,True\n")
    assert [run.name for run in find_runs(tmp_path)] == ["a", "b"]
