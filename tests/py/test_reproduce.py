"""Reproductions: verdicts, files, registry, command line, and the shortened flight of Fomichev and Tan."""

import csv
import json
import math
import re
import sys
import threading
from types import SimpleNamespace

import pytest
from matplotlib.figure import Figure

from gnssins import cli
from gnssins import reproduce as package
from gnssins.errors import ConfigError
from gnssins.reproduce import PUBLICATIONS, publication, publications, reproduce
from gnssins.reproduce.report import Claim, Job, Publication, Reproduction, Table

NAN = float("nan")


def claim(ours: float, target: float | None = None, sense: str = "at most", **keys: object) -> Claim:
    return Claim("key", "what", "m", ours, target, sense, **keys)


def report(**keys: object) -> Reproduction:
    claims = [
        Claim("good", "north", "m", 0.5, 1.0, published=2.0, sigma=0.45, median=0.3, p95=1.1),
        Claim("bad", "east", "m", 3.0, 1.0, note="the sensor allows no better"),
        Claim("open", "down", "m", NAN),
    ]
    table = Table("errors", "Errors", ["axis", "m"], [["north", 1.0 / 3.0], ["east", None], ["down", NAN]])
    return Reproduction(
        "novik-2011",
        "Trial",
        3,
        4,
        **{"claims": claims, "tables": [table], "figures": {"curve": Figure()}, **keys},
    )


# ---- verdicts


@pytest.mark.parametrize(
    ("found", "verdict"),
    [
        (claim(0.5, 1.0), "better by 2.0x"),
        (claim(0.97, 1.0), "reached"),
        (claim(1.0, 1.0), "reached"),
        (claim(1.0 + 1e-12, 1.0), "missed"),
        (claim(NAN, 1.0), "missed"),
        (claim(math.inf, 1.0), "missed"),
        (claim(0.0, 1.0), "reached"),
        (claim(0.0, 0.0), "reached"),
        (claim(-1.0, 0.0), "reached"),
        (claim(0.05, 1.0), "better by 20x"),
        (claim(3.6, 1.8, "at least"), "better by 2.0x"),
        (claim(1.8, 1.8, "at least"), "reached"),
        (claim(1.7, 1.8, "at least"), "missed"),
        (claim(math.inf, 1.8, "at least"), "reached"),
        (claim(9.0, sense="within", low=8.3, high=9.7), "reached"),
        (claim(8.3, sense="within", low=8.3, high=9.7), "reached"),
        (claim(9.71, sense="within", low=8.3, high=9.7), "missed"),
        (claim(9.71, sense="within", low=8.3), "reached"),
        (claim(NAN, sense="within", low=8.3), "missed"),
        (claim(11, 11, "equal"), "reached"),
        (claim(12, 11, "equal"), "missed"),
        (claim(11.4, 11, "equal", tolerance=0.5), "reached"),
        # the published figure takes the place of a target; without either nothing is judged
        (claim(1.0, None, published=3.0), "better by 3.0x"),
        (claim(4.0, None, published=3.0), "missed"),
        (claim(4.0), "measured"),
        (claim(1.0, sense="beside", published=3.0), "measured"),
        (claim(4.0, sense="beside", published=3.0), "measured"),
    ],
)
def test_verdicts(found, verdict):
    assert found.verdict == verdict
    assert found.met == (verdict not in ("missed", "measured"))
    assert found.line().startswith(verdict)
    assert "\n" not in found.line()
    json.dumps(found.to_dict(), allow_nan=False)


def test_a_line_tells_ours_wanted_published_sigma_and_why():
    line = Claim("k", "north", "m", 3.0, 1.0, published=2.5, sigma=0.9, note="drawn alike").line()
    assert (
        line
        == "missed          north: 3 m, wanted at most 1, published 2.5, filter's sigma 0.900 (drawn alike)"
    )


@pytest.mark.parametrize("keys", [{"sense": "within"}, {"sense": "about"}])
def test_a_claim_that_says_nothing_is_refused(keys):
    with pytest.raises(ValueError, match="claim key"):
        claim(1.0, 1.0, **keys)


def test_the_outcome_hides_nothing():
    assert report().outcome() == "1 of 2 claims reached, 1 of them better than wanted; 1 MISSED: bad"
    text = report().text()
    assert "1 MISSED: bad" in text
    assert "the sensor allows no better" in text
    assert report(claims=[claim(1.0, 1.0)]).outcome() == "1 of 1 claims reached"


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"claims": [claim(1.0), claim(2.0)]}, "more than one key"),
        ({"figures": {"../up": Figure()}}, "cannot be the name of a file"),
        ({"figures": {"Figure 1": Figure()}}, "cannot be the name of a file"),
    ],
)
def test_reports_that_could_not_be_written_are_refused(keys, words):
    with pytest.raises(ValueError, match=words):
        report(**keys)


def test_a_table_needs_as_many_cells_as_columns():
    with pytest.raises(ValueError, match="1 cells for 2 columns"):
        Table("t", "", ["a", "b"], [[1.0]])


# ---- files


def test_summary_json_has_claims_tables_versions_and_files(tmp_path):
    files = report().write(tmp_path / "out")
    summary = json.loads((tmp_path / "out" / "summary.json").read_text(), parse_constant=pytest.fail)
    assert set(summary) == {
        "format", "name", "title", "runs", "seed", "versions", "outcome", "claims", "tables", "files",
    }  # fmt: skip
    assert (summary["name"], summary["runs"], summary["seed"]) == ("novik-2011", 3, 4)
    assert set(summary["claims"][0]) >= {
        "key", "text", "unit", "ours", "target", "sense", "published", "sigma", "median", "p95", "verdict", "note",
    }  # fmt: skip
    assert [c["verdict"] for c in summary["claims"]] == ["better by 2.0x", "missed", "measured"]
    assert [c["met"] for c in summary["claims"]] == [True, False, None]
    assert summary["claims"][2]["ours"] is None
    assert summary["outcome"]["missed"] == ["bad"]
    assert summary["tables"][0]["rows"] == [["north", 1.0 / 3.0], ["east", None], ["down", None]]
    assert "gnssins" in summary["versions"]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted(summary["files"])
    assert [str(tmp_path / "out" / name) for name in summary["files"]] == files


def test_tables_keep_all_digits_in_csv(tmp_path):
    report().write(tmp_path)
    with (tmp_path / "errors.csv").open(newline="") as file:
        rows = list(csv.reader(file))
    assert rows == [["axis", "m"], ["north", repr(1.0 / 3.0)], ["east", ""], ["down", ""]]


def test_the_same_report_writes_the_same_bytes(tmp_path):
    for folder in ("a", "b"):
        report().write(tmp_path / folder)
    one, two = ((tmp_path / folder / "summary.json").read_bytes() for folder in "ab")
    assert one == two


def test_files_of_an_earlier_reproduction_go_and_others_stay(tmp_path):
    report().write(tmp_path)
    (tmp_path / "mine.csv").write_text("1\n")
    report(tables=[], figures={}).write(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine.csv", "report.txt", "summary.json"]


@pytest.mark.parametrize("text", ["{}", "not json", '{"name": "x", "files": ["mine.csv"]}', "[]"])
def test_a_summary_of_somebody_else_is_never_written_over(tmp_path, text):
    (tmp_path / "summary.json").write_text(text)
    with pytest.raises(ConfigError, match=r"config\.output_foreign"):
        report().write(tmp_path)
    assert (tmp_path / "summary.json").read_text() == text
    with pytest.raises(ConfigError, match=r"config\.output_foreign"):
        reproduce("fomichev-tan-2017", runs=1, out=tmp_path)


def test_a_folder_with_tables_of_somebody_else_is_refused_before_anything_is_computed(tmp_path):
    (tmp_path / "route.csv").write_text("1\n")
    with pytest.raises(ConfigError, match=r"config\.output_foreign.*1 tables.*route\.csv"):
        reproduce("fomichev-tan-2017", runs=10**9, out=tmp_path)


def test_a_forged_list_of_files_removes_nothing_outside(tmp_path):
    (tmp_path / "keep.csv").write_text("1\n")
    folder = tmp_path / "out"
    folder.mkdir()
    (folder / "data.toml").write_text("1\n")
    forged = {"format": 1, "name": "x", "claims": [], "files": ["../keep.csv", "data.toml", 7]}
    (folder / "summary.json").write_text(json.dumps(forged))
    report().write(folder)
    assert (tmp_path / "keep.csv").exists()
    assert (folder / "data.toml").exists()


def test_inputs_are_never_written_over(tmp_path):
    source = tmp_path / "errors.csv"
    source.write_text("1\n")
    with pytest.raises(ConfigError, match=r"config\.output_is_input"):
        report(inputs=[source]).write(tmp_path)
    assert source.read_text() == "1\n"


def test_a_file_is_no_folder(tmp_path):
    (tmp_path / "out").write_text("")
    with pytest.raises(ConfigError, match=r"config\.output_not_folder"):
        report().write(tmp_path / "out")


# ---- jobs


def test_a_job_gives_results_in_order_and_shares_that_rise_to_one():
    shares: list[float] = []
    job = Job(5, 0, jobs=3, progress=shares.append)
    job.expect(12)
    threads = set()

    def work(k: int) -> int:
        threads.add(threading.current_thread().name)
        return k * k

    assert job.map(work, 10, "squares", units=8) == [k * k for k in range(10)]
    told = job.part(4, "rest")
    told(0.5)
    told(1.0)
    assert shares == sorted(shares)
    assert shares[9] == pytest.approx(8 / 12)
    assert shares[-1] == 1.0
    assert threading.current_thread().name not in threads


def test_the_first_error_of_a_job_comes_out_as_it_is():
    def work(k: int) -> int:
        if k == 3:
            raise ConfigError("config.range", "three")
        return k

    with pytest.raises(ConfigError, match="three"):
        Job(5, 0, jobs=2).map(work, 10)


# ---- registry


def test_the_registry_has_the_five_and_its_modules_say_so():
    assert list(PUBLICATIONS) == [
        "fomichev-tan-2017", "novik-2011", "vasilyuk-2019", "al-bitar-gavrilov-2019", "aleshkin-2021",
    ]  # fmt: skip
    for name, found in publications().items():
        if found is not None:
            assert found.name == name
            assert found.runs >= 1
            assert found.summary
            assert "\n" not in found.summary


def test_a_module_that_is_missing_does_not_break_the_list(monkeypatch):
    monkeypatch.setattr(package, "PUBLICATIONS", {**PUBLICATIONS, "nobody-1900": "gnssins.reproduce.nobody"})
    assert publications()["nobody-1900"] is None
    assert publications()["fomichev-tan-2017"] is not None
    with pytest.raises(ConfigError, match="cannot be reproduced by this version"):
        publication("nobody-1900")


def test_a_module_that_fails_to_load_is_not_hidden(monkeypatch, tmp_path):
    (tmp_path / "broken_publication.py").write_text("import no_such_module_at_all\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(package, "PUBLICATIONS", {"broken": "broken_publication"})
    with pytest.raises(ModuleNotFoundError, match="no_such_module_at_all"):
        publications()


@pytest.mark.parametrize(
    ("name", "nearest"), [("fomichev", "fomichev-tan-2017"), ("novik-2012", "novik-2011"), ("zzz", "--list")]
)
def test_an_unknown_name_is_answered_with_the_nearest(name, nearest):
    with pytest.raises(ConfigError) as caught:
        reproduce(name)
    assert nearest in caught.value.hint


@pytest.mark.parametrize("keys", [{"runs": 0}, {"seed": -1}, {"jobs": 0}])
def test_numbers_out_of_range_are_refused_before_anything_runs(keys):
    with pytest.raises(ConfigError, match=r"config\.range"):
        reproduce("fomichev-tan-2017", **keys)


# ---- command line


@pytest.fixture
def command(capsys, monkeypatch):
    """Run the command in this process; gives exit code, stdout, stderr."""

    def call(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["gnssins", *map(str, arguments)])
        code = cli._guarded()
        out, err = capsys.readouterr()
        return code, out, err

    return call


@pytest.fixture
def trial(monkeypatch):
    """A publication that only reports; gives the jobs that it was asked for."""
    asked: list[Job] = []

    def run(job: Job) -> Reproduction:
        asked.append(job)
        return report()

    module = SimpleNamespace(PUBLICATION=Publication("trial", "Trial", "A trial", 7, 8, run))
    monkeypatch.setitem(sys.modules, "gnssins.reproduce.trial", module)
    monkeypatch.setattr(package, "PUBLICATIONS", {"trial": "gnssins.reproduce.trial"})
    return asked


def test_the_list_shows_one_line_per_publication(command):
    code, out, _ = command("reproduce", "--list")
    assert code == 0
    for name in PUBLICATIONS:
        assert len(re.findall(rf"^{name} ", out, re.MULTILINE)) == 1
    code, out, _ = command("reproduce", "--list", "--json")
    rows = json.loads(out)["publications"]
    assert [row["name"] for row in rows] == list(PUBLICATIONS)
    assert rows[0]["runs"] == 100


def test_missed_claims_are_told_and_the_command_still_succeeds(command, trial, tmp_path):
    code, out, err = command(
        "reproduce", "trial", "--out", tmp_path / "r", "--runs", 2, "--seed", 9, "--jobs", 1
    )
    assert (code, err) == (0, "")
    assert (trial[0].runs, trial[0].seed, trial[0].jobs) == (2, 9, 1)
    assert "1 MISSED: bad" in out
    assert str(tmp_path / "r" / "summary.json") in out
    assert (tmp_path / "r" / "curve.png").stat().st_size > 0


def test_json_is_one_document_and_defaults_are_those_of_the_publication(
    command, trial, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    code, out, err = command("reproduce", "trial", "--json")
    found = json.loads(out)
    assert (code, err) == (0, "")
    assert (trial[0].runs, trial[0].seed) == (7, 8)
    assert found["out"] == "trial-reproduction"
    assert (tmp_path / "trial-reproduction" / "summary.json").is_file()
    assert found["claims"][1]["verdict"] == "missed"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("reproduce",), "gnssins reproduce --list"),
        (("reproduce", "novik"), r'config\.publication.*nearest: "novik-2011"'),
        (("reproduce", "fomichev-tan-2017", "--runs", "0"), "runs"),
        (("reproduce", "fomichev-tan-2017", "--seed", "-1"), "seed"),
    ],
)
def test_what_the_user_can_change_leaves_with_1(command, arguments, words):
    code, out, err = command(*arguments)
    assert (code, out) == (1, "")
    assert re.search(words, err, re.DOTALL)
    assert "Traceback" not in err


def test_ctrl_c_leaves_quietly_and_writes_nothing(command, trial, tmp_path, monkeypatch):
    def interrupted(job: Job) -> Reproduction:
        raise KeyboardInterrupt

    found = sys.modules["gnssins.reproduce.trial"]
    monkeypatch.setattr(found, "PUBLICATION", Publication("trial", "Trial", "A trial", 7, 8, interrupted))
    code, out, err = command("reproduce", "trial", "--out", tmp_path / "r")
    assert (code, out, err) == (130, "", "")
    assert not (tmp_path / "r").exists()


# ---- documentation


def test_pages_show_figures_that_are_there_and_small(repository):
    pages = repository / "docs" / "publications"
    for page in pages.glob("*.md"):
        text = page.read_text(encoding="utf-8")
        for name in re.findall(r"\]\((figures/[^)]+)\)", text):
            assert 0 < (pages / name).stat().st_size < 100_000, name
        whole = page.stem.removesuffix("-filter")  # a part that its page includes
        assert whole == "index" or whole in PUBLICATIONS


def test_the_index_and_the_page_say_the_same_and_nothing_is_left_to_fill_in(repository):
    pages = repository / "docs" / "publications"
    index = (pages / "index.md").read_text(encoding="utf-8")
    for page in pages.glob("*-20??.md"):
        text = page.read_text(encoding="utf-8")
        assert not re.search(r"<!-- (claims|table \w+) -->\s*<!-- end -->", text), page.name
        outcome = re.search(r"<!-- claims -->\s*(`gnssins reproduce .+)", text)
        assert outcome
        assert outcome[1] in index


def test_the_python_of_the_how_to_runs(repository, capsys):
    text = (repository / "docs" / "howto" / "reproduce.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"^```python\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL)
    exec(compile(block, "howto/reproduce.md", "exec"), {})
    assert "error/sigma" in capsys.readouterr().out


def test_columns_of_a_csv_file_have_names_of_their_own(tmp_path):
    table = Table("t", "Title", ("", "a", "sigma", "b", "sigma"), [["x", 1.0, 2.0, 3.0, 4.0]])
    table.write_csv(tmp_path / "t.csv")
    head = (tmp_path / "t.csv").read_text().splitlines()[0]
    assert head == "column_1,a,sigma,b,sigma (2)"
