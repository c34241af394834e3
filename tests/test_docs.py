"""The pages of docs/ name files that exist, and the figure has a place for every folder."""

import json
import os
import re
import runpy
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = sorted((ROOT / "docs").glob("*.md"))
# A file that a recipe's reader makes.
TO_BE_MADE = {"jax_inertia/logs/readers/NAME.py"}


def named_paths(text: str) -> set[str]:
    """Paths from the checkout's root in backticks."""
    return set(re.findall(r"`((?:jax_inertia|tests|benchmarks|docs)/[\w./]+)`", text)) - TO_BE_MADE


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_and_paths_lead_somewhere(page):
    text = page.read_text()
    links = {link for link in re.findall(r"\]\(([^)#]+)\)", text) if "://" not in link}
    assert [link for link in sorted(links) if not (page.parent / link).exists()] == []
    paths = named_paths(text)
    if not (ROOT / "jax_inertia" / "diagnosis").exists():
        paths = {path for path in paths if not path.startswith("jax_inertia/diagnosis/")}
    assert [path for path in sorted(paths) if not (ROOT / path).exists()] == []


def test_the_recipes_name_paths():
    assert len(named_paths((ROOT / "docs" / "contributing.md").read_text())) > 10


def test_the_figure_has_every_folder_and_every_arrow_points_down():
    figure = runpy.run_path(str(ROOT / "docs" / "figures" / "architecture.py"))
    modules, arrows = figure["imports"]()
    places = figure["FOLDERS"]
    assert set(modules) <= set(places)
    assert len(arrows) > 20
    upward = [(a, b) for a, b in arrows if places[b][3] >= places[a][3]]
    assert upward == []


def test_the_page_of_effects_is_what_the_registry_says():
    page = runpy.run_path(str(ROOT / "docs" / "effects.py"))["text"]()
    assert (ROOT / "docs" / "effects.md").read_text() == page, "run python docs/effects.py"


README = (ROOT / "README.md").read_text()


def test_the_readme_is_short_and_its_links_lead_into_the_repository():
    """Relative links: they work in any clone, whoever owns it."""
    assert len(README.splitlines()) <= 150
    links = re.findall(r"\]\(([^)#]+)\)", README)
    images = dict(re.findall(r"^\[(\w+)\]: (\S+)$", README, re.MULTILINE))
    assert len(links) > 10
    assert len(images) == 3
    assert [name for name in [*links, *images.values()] if not (ROOT / name).is_file()] == []
    assert [name for name in images.values() if (ROOT / name).stat().st_size > 160_000] == []
    assert set(re.findall(r"\]\[(\w+)\]", README)) == set(images)


def test_no_page_names_an_owner_that_is_not_known_to_exist():
    pages = [ROOT / "README.md", ROOT / "pyproject.toml", ROOT / "docs" / "mkdocs.yml", *PAGES]
    assert [p.name for p in pages if "jax-inertia/jax-inertia" in p.read_text()] == []


def test_what_pages_say_to_install_is_an_extra():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"][
        "optional-dependencies"
    ]
    pages = [ROOT / "README.md", ROOT / "notebooks" / "README.md", *PAGES]
    named = {
        name
        for page in pages
        for names in re.findall(r"pip install (?:-e )?[\"']?\.\[([\w,]+)\]", page.read_text())
        for name in names.split(",")
    }
    assert named >= {"gpu", "readers", "test", "dev"}
    assert named <= extras.keys()


def test_every_page_is_in_the_navigation():
    named = set(re.findall(r"(\w+\.md)$", (ROOT / "docs" / "mkdocs.yml").read_text(), re.MULTILINE))
    assert named == {page.name for page in PAGES}


def test_anchors_of_links_are_headings():
    def anchors(page):
        titles = re.findall(r"^#+ (.+)$", page.read_text(), re.MULTILINE)
        return {re.sub(r"\s+", "-", re.sub(r"[^\w\s-]", "", t.lower()).strip()) for t in titles}

    wrong = [
        (page.name, f"{name}#{anchor}")
        for page in PAGES
        for name, anchor in re.findall(r"\]\((\w*(?:\.md)?)#([^)]+)\)", page.read_text())
        if anchor not in anchors(page.parent / (name or page.name))
    ]
    assert wrong == []


def test_the_docs_build_without_a_warning(tmp_path):
    if "JAX_INERTIA_CI" not in os.environ:  # which installs what it needs: there this fails without
        pytest.importorskip("material", reason="no mkdocs-material here")
        pytest.importorskip("mkdocstrings", reason="no mkdocstrings here")
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "mkdocs",
            "build",
            "--strict",
            "-q",
            "-f",
            "docs/mkdocs.yml",
            "-d",
            tmp_path,
        ],
        cwd=ROOT,
        env={**os.environ, "DISABLE_MKDOCS_2_WARNING": "true", "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    page = (tmp_path / "api" / "index.html").read_text()
    assert "torque_regressor" in page
    assert "&gt;&gt;&gt;" in page


def programs(page: str) -> list[str]:
    return re.findall(r"```python\n(.*?)```", (ROOT / "docs" / page).read_text(), re.DOTALL)


@pytest.mark.parametrize("page", ["start_arm.md", "start_policy.md"])
def test_the_logs_of_the_first_hours_are_recorded(page, tmp_path, monkeypatch):
    """By the page's own program, which is plain MuJoCo; the log fits the model that lies beside it."""
    import jax_inertia as ji

    monkeypatch.chdir(tmp_path)
    (program,) = programs(page)
    assert "jax_inertia" not in program
    exec(compile(program, page, "exec"), {})
    (model,) = tmp_path.glob("*.xml")
    log, robot = ji.read_log("log.npz"), ji.load_model(model)
    assert log.joint_names == robot.joint_names
    assert log.duration > 10


@pytest.mark.slow
@pytest.mark.parametrize("page", ["start_jax.md", "live.md"])
def test_the_programs_of_a_page_run(page, capsys):
    exec(compile("\n".join(programs(page)), page, "exec"), {})
    assert "kg" in capsys.readouterr().out


QUOTED = runpy.run_path(str(ROOT / "docs" / "quoted.py"))


def test_quoted_outputs_may_differ_by_rounding_and_not_by_more():
    page = "<!-- output of jax-inertia x -->\n\n    error 2.15 N m, mass 0.1 ± 4.0 kg\n"
    near, far = page.replace("2.15", "2.2").replace("0.1 ±", "-0.2 ±"), page.replace("2.15", "2.5")
    assert QUOTED["differences"](page, near) == []
    (wrong,) = QUOTED["differences"](page, far)
    assert "2.15 is now 2.5" in wrong
    assert QUOTED["differences"](page, page.replace("mass", "weight"))
    printed = {"jax-inertia x": "error 2.5 N m, mass 0.1 ± 4.0 kg\nmore\n"}
    assert QUOTED["renewed"](page, printed) == far


@pytest.mark.parametrize("page", QUOTED["PAGES"], ids=lambda page: page.stem)
def test_quoted_outputs_are_of_commands_of_the_page(page):
    text = page.read_text()
    quoted = [hit["command"] for hit in QUOTED["BLOCK"].finditer(text)]
    assert quoted
    assert len(quoted) == text.count("<!-- output of")
    assert [command for command in quoted if f"    {command}\n" not in text] == []


@pytest.mark.slow
def test_quoted_outputs_are_what_is_printed(monkeypatch):
    monkeypatch.setattr(sys, "argv", ["quoted.py", "--check"])
    assert QUOTED["main"]() == 0


@pytest.mark.slow
def test_an_arm_s_first_hour(tmp_path, monkeypatch, capsys):
    """The commands of the page, on its own log: friction as put in, and the load."""
    from jax_inertia.cli.main import main

    monkeypatch.chdir(tmp_path)
    exec(compile(programs("start_arm.md")[0], "start_arm.md", "exec"), {})
    assert main(["diagnose", "log.npz", "--model", "arm.xml", "--test-log", "other.npz"]) == 0
    assert "99 % of the torque" in " ".join(capsys.readouterr().out.split())
    report = json.loads((tmp_path / "out" / "log" / "report.json").read_text())
    assert report["verdict"] == "explained"
    friction = {n: own["coulomb_friction"]["value"] for n, own in report["joints"].items()}
    assert friction == pytest.approx({"turn": 0.9, "shoulder": 1.2, "elbow": 0.6}, rel=0.05)
    command = ["estimate", "loaded.npz", "--model", "out/log/corrected.xml", "--bodies", "lower"]
    assert main(command) == 0
    report = json.loads((tmp_path / "out" / "loaded" / "estimate" / "report.json").read_text())
    body = report["bodies"]["lower"]
    assert body["batch"]["mass_kg"]["value"] == pytest.approx(2.1, abs=0.02)


@pytest.mark.slow
def test_a_policy_s_first_hour(tmp_path, monkeypatch):
    from jax_inertia.cli.main import main

    monkeypatch.chdir(tmp_path)
    exec(compile(programs("start_policy.md")[0], "start_policy.md", "exec"), {})
    assert main(["diagnose", "log.npz", "--model", "leg.xml", "--test-log", "other.npz"]) == 0
    report = json.loads((tmp_path / "out" / "log" / "report.json").read_text())
    found = {e["family"]: next(iter(e["parameters"].values())) for e in report["effects"]}
    assert found.keys() == {"target_delay", "kp_scale"}
    assert found["kp_scale"]["value"] == pytest.approx(0.7, rel=0.03)
    # 5 % off: the first target's jolt told it to half a per cent, and the start no longer counts.
    assert found["target_delay"]["value"] == pytest.approx(0.02, abs=1.1e-3)
    low, high = found["target_delay"]["ci95"]
    assert low < 0.02 < high
    assert (tmp_path / "out" / "log" / "policy.json").is_file()


def test_the_reference_has_every_name_that_the_package_gives():
    import jax_inertia as ji

    page = (ROOT / "docs" / "api.md").read_text()
    named = re.findall(r"^::: [\w.]+\.(\w+)$", page, re.MULTILINE)
    for members in re.findall(r"members: \[(.*)\]", page):
        named += members.split(", ")
    # A warning has nothing to be called with.
    own = {name: ji._PLACES[name][1] for name in ji.__all__}
    assert {name for name in own if own[name] not in named} <= {"ModelWarning"}
    aliases = {name for name in own if own[name] != name}
    assert {name for name in aliases if f"ji.{name}" not in page} == set()
