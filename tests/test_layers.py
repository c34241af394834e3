"""Imports point one way: each module may use its own layer and those before it, and no cycle."""

import ast
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "jax_inertia"
# From the ground up. A folder stands for all that is in it.
LAYERS: dict[str, str] = {
    "maths": """_arguments _batch_last _readable _vectors spatial inertia charts gates noise physical kalman
        least_squares""",
    "logs": """_npz _names _files _torque_unit _contract bands readers log log_chunks held _findings slopes signals
        motion differences _check_channels _check_consistency preflight""",
    "robot": """_mujoco_types _mujoco_warnings robot _geometry _model_text _urdf_base _urdf_repair _descriptions _spec
        _urdf _finite mjcf robots""",
    "dynamics": "kinematics _rows _passes dynamics wrench_axes",
    "estimation and simulation": """measurement fused estimate batch _batch_rows _batch_solve consistency
        _filter_settings handover logfilter priors identifiability motion_limits suggest_motion stream statefile
        simulate""",
    "gap": "gap",
    "diagnosis": "diagnosis",
    "control": "control",
    "command line": """_console _completion _convert_command _model_of_log _model_output _diagnose_command _diagnose_run
        _diagnose_whole _estimate_command _estimate_run _estimate_output _suggest_motion_command plots demo cli
        __main__""",
}
RANK = {name: rank for rank, names in enumerate(LAYERS.values()) for name in names.split()}
# A leaf: nothing else may need a controller.
LEAVES = {"control": {"control", "cli", "__main__"}}


def module_name(path: Path) -> str:
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_name(path): path for path in sorted(PACKAGE.rglob("*.py"))}


def imports_of(name: str, source: str) -> set[str]:
    """Modules of the package that the source imports, anywhere in it; what is not a module is an error."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            wanted = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name}: relative import, line {node.lineno}"
            wanted = [f"{node.module}.{alias.name}" for alias in node.names]
        else:
            continue
        for full in wanted:
            head, _, rest = full.partition(".")
            if head != PACKAGE.name:
                continue
            # `from package.module import thing` names the module, `from package import module` too.
            while rest and rest not in MODULES:
                rest = rest.rpartition(".")[0]
            assert rest, f"{name}: {full} is not a module; inside the package import from modules"
            found.add(rest)
    return found


def upward(name: str, imported: set[str]) -> list[str]:
    """One line for each import that points up, or into a leaf."""
    own = name.partition(".")[0]
    lines = []
    for other in sorted(imported):
        top = other.partition(".")[0]
        # What has no place yet is for `test_every_module_has_its_place` to report.
        if RANK.get(top, 0) > RANK[own]:
            lines.append(f"{name} imports {other}, which is in a layer above it")
        if own not in LEAVES.get(top, {own}):
            lines.append(f"{name} imports {other}, which is a leaf")
    return lines


GRAPH = {name: path.read_text() for name, path in MODULES.items() if name}


def test_every_module_has_its_place():
    unplaced = sorted({name.partition(".")[0] for name in GRAPH} - RANK.keys())
    assert not unplaced, f"give these modules a layer in {Path(__file__).name}: {unplaced}"


@pytest.mark.parametrize("name", GRAPH)
def test_imports_point_down(name):
    if name.partition(".")[0] in RANK:
        assert upward(name, imports_of(name, GRAPH[name])) == []


def test_no_cycles():
    graph = {name: imports_of(name, source) - {name} for name, source in GRAPH.items()}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail("modules import each other: " + " → ".join(error.args[1]))


@pytest.mark.parametrize("name", [n for n in GRAPH if RANK.get(n.partition(".")[0], 9) < 2])
def test_maths_and_logs_know_no_simulator(name):
    tree = ast.parse(GRAPH[name])
    names = {a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names}
    names |= {n.module for n in ast.walk(tree) if isinstance(n, ast.ImportFrom) and n.module}
    assert not any(n.partition(".")[0] == "mujoco" for n in names)


def test_the_rules_can_fail():
    assert upward("kalman", imports_of("kalman", "from jax_inertia import robot"))
    assert upward("dynamics", imports_of("x", "def f():\n    from jax_inertia.gap.chain import A"))
    assert not upward("gap.chain", imports_of("x", "import jax_inertia.dynamics"))
    with pytest.raises(AssertionError, match="import from modules"):
        imports_of("gap.chain", "from jax_inertia import load_model")
    with pytest.raises(AssertionError, match="relative"):
        imports_of("gap.chain", "from . import context")
