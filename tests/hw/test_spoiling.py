"""The tests of the safety side, tested: each of its slips is noticed by one of them; and the tool that tries that out."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.hw import emulator
from tests.hw.spoil.byhand import BY_HAND
from tests.hw.spoil.equivalent import check_equivalent
from tests.hw.spoil.operators import changes, shuffled
from tests.hw.spoil.runner import FIRST, NOTHING, Drawing, code_of, files_for, try_out
from tests.hw.spoil.spoiling import BOARD, DRAWS, FIRMWARE, OTHER, ROOT, Slip, Spoiling, StaleError, source
from tests.hw.spoil.table import LEFT_OUT, SPOILINGS, Outcome, Row, caught_last_time, survivors, write_tables

CRASHES = ("the decoder writes behind its buffer",)
"""What stops the tests themselves."""
NUMBERED = [(file, number) for file, count in DRAWS.items() for number in range(count)]
EACH = 3
"""One of so many is slow, the others are a study."""


def often(number: int) -> pytest.MarkDecorator:
    """How often a slip is tried out, by its number."""
    return pytest.mark.study if number % EACH else pytest.mark.slow


@pytest.mark.slow
def test_nothing_is_caught_where_nothing_is_wrong(tmp_path: Path) -> None:
    assert try_out(NOTHING, tmp_path / "run").caught is None


@pytest.mark.parametrize("name", [pytest.param(name, marks=often(k)) for k, name in enumerate(BY_HAND)])
def test_slips_by_hand_are_caught(name: str, tmp_path: Path) -> None:
    if lacking := emulator.missing():
        pytest.skip(lacking)
    outcome = try_out(BY_HAND[name].find(), tmp_path / "run")
    print(outcome)
    assert outcome.caught not in (None, "compiler")


@pytest.mark.parametrize(
    ("file", "number"),
    [pytest.param(file, number, marks=often(k), id=f"{Path(file).name}-{number}") for k, (file, number) in enumerate(NUMBERED)],
)
def test_drawn_slips_are_caught(file: str, number: int, tmp_path: Path) -> None:
    if lacking := emulator.missing():
        pytest.skip(lacking)
    spoiling = Drawing(file, tmp_path / "draw").draw(number)
    outcome = try_out(spoiling, tmp_path / "run")
    print(spoiling.name, *spoiling.lines(source(file)), outcome, sep="\n")
    assert outcome.caught not in (None, "compiler"), (spoiling.name, *spoiling.lines(source(file)))


def test_there_are_enough() -> None:
    """Of every file of the firmware and of the host's side of the line, or it says why not."""
    assert len(NUMBERED) >= len(BY_HAND) >= 60
    assert len([*BY_HAND][::EACH]) + len(NUMBERED[::EACH]) >= 60
    assert all(count >= 1 for count in DRAWS.values())
    there = [*(ROOT / FIRMWARE).glob("*.cpp"), *(ROOT / BOARD).glob("*.py")]
    assert {path.relative_to(ROOT).as_posix() for path in there} <= {*DRAWS, *OTHER}
    for slip in BY_HAND.values():
        assert slip.find().spoil(source(slip.file)) != source(slip.file)
    check_equivalent()


def test_the_last_study_has_them() -> None:
    """spoil/caught.csv names all slips by hand, and for each a test that exists."""
    for slip in BY_HAND.values():
        caught = caught_last_time(slip.find())
        assert caught or slip.name in CRASHES, (
            f"{slip.name}: python -m tests.hw.spoil OUT, then keep spoilings.csv as tests/hw/spoil/caught.csv"
        )
        for test in caught:
            file, *_, name = test.split("::")
            assert f"def {name}(" in (ROOT / "tests" / "hw" / file).read_text(encoding="utf-8"), test


def test_survivors_are_named_and_written(tmp_path: Path) -> None:
    slips = [slip.find() for slip in [*BY_HAND.values()][:3]]
    drawn = shuffled(slips[0].file, source(slips[0].file), 1)[0]
    found = (Outcome("test_link.py::test_a", 1.0), Outcome(None, 2.0), Outcome("compiler", 0.1))
    rows = [Row(slip, False, outcome) for slip, outcome in zip(slips, found, strict=True)]
    rows.append(Row(drawn, True, found[0], [(drawn, "is the same program")]))
    assert survivors(rows) == [f"{Path(slip.file).name}: {slip.name}" for slip in slips[1:]]
    write_tables(rows, tmp_path / "out")
    written = (tmp_path / "out" / SPOILINGS).read_text(encoding="utf-8").splitlines()
    assert written[0] == "file,spoiling,line,becomes,caught_by"
    assert [line.rpartition(",")[2] for line in written[1:]] == ["test_link.py::test_a", "survived", "compiler", "test_link.py::test_a"]
    assert (tmp_path / "out" / LEFT_OUT).read_text(encoding="utf-8").endswith(",is the same program\n")


def test_named_test_files_exist() -> None:
    assert all((ROOT / "tests" / "hw" / f"{name}.py").exists() for names in FIRST.values() for name in names)
    for file in DRAWS:
        tests = files_for(file)
        assert len(tests) == len(set(tests)) >= 6
        assert not any("spoiling" in name for name in tests)


def test_operators_in_cpp() -> None:
    text = 'int a = 1;  // a < 1\nif (b < 2 && "b < 2") c(3);\n#if D > 4\n'
    found = {(change.name, change.spoil(text).splitlines()[1 if change.start > 20 else 0]) for change in changes("x.cpp", text)}
    assert found == {
        ("constant changed", "int a = 0;  // a < 1"),
        ("constant changed", 'if (b < 4 && "b < 2") c(3);'),
        ("constant changed", 'if (b < 2 && "b < 2") c(6);'),
        ("comparison turned", 'if (b > 2 && "b < 2") c(3);'),
        ("boundary moved", 'if (b <= 2 && "b < 2") c(3);'),
        ("and for or", 'if (b < 2 || "b < 2") c(3);'),
        ("condition negated", 'if (!(b < 2 && "b < 2")) c(3);'),
    }


def test_statements_in_cpp() -> None:
    text = "void f() {\n  a = b;\n  c = a;\n  const int d = 1;\n}\n"
    found = {change.spoil(text) for change in changes("x.cpp", text) if "statement" in change.name}
    assert found == {
        text.replace("a = b;", "{}"),
        text.replace("c = a;", "{}"),
        text.replace("a = b;\n  c = a;", "c = a;\n  a = b;"),
    }


def test_operators_in_python() -> None:
    text = 'def f(a: int = 3) -> int | None:\n    """1 < 2"""\n    if not a == 2: a += 1; g(a)\n'
    found = {(change.name, change.spoil(text).splitlines()[2 if change.start > 20 else 0].strip()) for change in changes("x.py", text)}
    assert found == {
        ("constant changed", "def f(a: int = 6) -> int | None:"),
        ("constant changed", "if not a == 4: a += 1; g(a)"),
        ("constant changed", "if not a == 2: a += 0; g(a)"),
        ("comparison turned", "if not a != 2: a += 1; g(a)"),
        ("not left out", "if a == 2: a += 1; g(a)"),
        ("condition negated", "if (not (not a == 2)): a += 1; g(a)"),
        ("statement left out", "if not a == 2: pass; g(a)"),
        ("statement left out", "if not a == 2: a += 1; pass"),
        ("statements swapped", "if not a == 2: g(a); a += 1"),
    }


@pytest.mark.slow
def test_same_seed_same_draws() -> None:
    for file in DRAWS:
        first, same, other = (shuffled(file, source(file), seed) for seed in (1, 1, 2))
        assert first == same
        assert first != other
        assert sorted(map(repr, first)) == sorted(map(repr, other))


@pytest.mark.slow
def test_draws_are_other_programs(tmp_path: Path) -> None:
    """No draw is what the compiler makes the same of; different numbers are different draws."""
    assert code_of("a = 1\n\n\nb = (a)") == code_of("a = 1\nb = a  # the same")
    assert code_of("a = 1") != code_of("a = True")
    assert code_of("a = ") is None
    drawn = [Drawing(f"{BOARD}/rig.py", tmp_path).draw(number) for number in range(5)]
    assert len(set(drawn)) == 5
    if not emulator.missing():
        drawing = Drawing(f"{FIRMWARE}/config.h", tmp_path)
        plain = drawing._build(drawing.text)
        assert plain is not None
        assert drawing._build(drawing.text + "// another line\n") == plain
        assert drawing._build(drawing.text + "#error\n") is None
        assert drawing._build(drawing.draw(0).spoil(drawing.text)) not in (plain, None)


def codes(text: str) -> Spoiling:
    """DAC_CODES is something else."""
    return Slip("codes", f"{BOARD}/protocol.py", "\nDAC_CODES = 4096\n", f"\nDAC_CODES = {text}\n").find()


@pytest.mark.slow
def test_caught_or_survived(tmp_path: Path) -> None:
    """A test that fails on the spoilt copy catches it; where none fails, it has survived; tests that hang are told apart."""
    test = tmp_path / "test_tiny.py"
    test.write_text("from tepm_opt.hw.board.protocol import DAC_CODES\n\ndef test_codes():\n    assert DAC_CODES == 4096\n")
    for text, limit, caught in (("4095", 60.0, "test_codes"), ("4000 + 96", 60.0, None), ("4096\nwhile True: pass", 3.0, "time-out")):
        outcome = try_out(codes(text), tmp_path / "run", [str(test)], limit)
        assert (outcome.caught and outcome.caught.rpartition("::")[2]) == caught
        assert {path.name for path in tmp_path.iterdir()} - {"__pycache__"} == {test.name}
    assert "\nDAC_CODES = 4096\n" in source(f"{BOARD}/protocol.py")


@pytest.mark.slow
def test_no_tests_are_no_catch(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="cannot be run"):
        try_out(codes("4095"), tmp_path / "run", ["tests/hw/test_that_does_not_exist.py"])


def test_lost_anchor() -> None:
    with pytest.raises(StaleError, match=r"'nothing': tepm_opt/hw/board/rig\.py has 0 times, not once: 'no such line'"):
        Slip("nothing", f"{BOARD}/rig.py", "no such line", "").find()
