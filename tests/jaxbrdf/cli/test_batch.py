"""Many files through a toy command: chunks, failures, resuming, interrupts."""

from collections.abc import Sequence
from pathlib import Path

import pytest
from rich.console import Console

from jaxbrdf.cli import batch


class Doubling(batch.Task[int, int, int]):
    """Reads a whole number from each file; 13 cannot be processed."""

    def __init__(self, already: dict[str, int] | None = None, interrupt_at: str = ""):
        self.already, self.interrupt_at, self.calls = already or {}, interrupt_at, []

    def finished(self, path: Path) -> int | None:
        return self.already.get(path.name)

    def read(self, path: Path) -> int:
        return int(path.read_text())

    def process(self, inputs: Sequence[int]) -> Sequence[int]:
        self.calls.append(list(inputs))
        if 13 in inputs:
            raise ValueError("13 brings\nbad luck")
        return [2 * number for number in inputs]

    def save(self, path: Path, content: int, output: int) -> int:
        if path.name == self.interrupt_at:
            raise KeyboardInterrupt
        return output


@pytest.fixture
def files(tmp_path):
    """A function that writes texts into the files 0, 1, 2 … and returns their paths."""

    def write(*texts: str) -> list[Path]:
        for name, text in enumerate(texts):
            (tmp_path / str(name)).write_text(text)
        return [tmp_path / str(name) for name in range(len(texts))]

    return write


def run(paths, task, chunk=2):
    return batch.run(paths, task, Console(stderr=True), chunk)


def test_files_are_processed_in_chunks(files):
    task = Doubling()
    report = run(files("1", "2", "3", "4", "5"), task)
    assert task.calls == [[1, 2], [3, 4], [5]]
    assert list(report.records.values()) == [2, 4, 6, 8, 10]
    assert report.exit_status == 0


def test_an_unreadable_file_is_reported_and_the_others_go_on(files):
    paths = files("1", "two", "3")
    report = run([*paths, paths[0].with_name("absent")], Doubling())
    assert report.records == {paths[0]: 2, paths[2]: 6}
    assert "'two'" in report.errors[paths[1]]
    assert report.errors[paths[0].with_name("absent")] == "No such file or directory"
    assert report.exit_status == 1


def test_one_file_at_fault_does_not_take_its_chunk_along(files):
    paths = files("1", "13", "3")
    report = run(paths, Doubling(), chunk=3)
    assert report.records == {paths[0]: 2, paths[2]: 6}
    assert report.errors == {paths[1]: "13 brings bad luck"}


def test_nothing_usable_is_status_2(files):
    assert run(files("one", "two"), Doubling()).exit_status == 2


def test_what_is_finished_is_kept_and_not_read(files):
    paths = files("1", "unreadable", "3")
    task = Doubling(already={"1": 4})
    report = run(paths, task)
    assert report.records == {paths[0]: 2, paths[1]: 4, paths[2]: 6}
    assert report.kept == {paths[1]}
    assert task.calls == [[1, 3]]


def test_an_interrupt_leaves_what_was_saved(files):
    paths = files("1", "2", "3")
    report = run(paths, Doubling(interrupt_at="1"))
    assert report.records == {paths[0]: 2}
    assert report.interrupted
    assert report.exit_status == 130


def test_a_bug_is_not_a_bad_file(files):
    class Buggy(Doubling):
        def process(self, inputs):
            raise TypeError("ours")

    with pytest.raises(TypeError, match="ours"):
        run(files("1"), Buggy())


def test_two_files_of_one_stem_are_refused():
    with pytest.raises(batch.Refused, match=r"'nickel': a/nickel.binary, b/nickel.binary"):
        batch.one_stem_each([Path("a/nickel.binary"), Path("a/chrome.binary"), Path("b/nickel.binary")])


def test_an_output_folder_may_be_new_but_no_file(tmp_path):
    batch.writable_folder(tmp_path / "new" / "newer")
    (tmp_path / "file").touch()
    for out in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(batch.Refused, match="is a file"):
            batch.writable_folder(out)
