"""Imports point one way, between folders and inside each of them, and make no cycle."""

import ast
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "jax_inertia"
# Folder: its modules and folders from the ground up; each may use those before it. A folder stands for all that is in
# it.
ORDER: dict[str, str] = {
    "": """text maths logs model dynamics signals preflight estimation diagnosis likelihood replay trainers fleet
        control robots cli __main__""",
    "text": "closest_names notebook_page progress remedies report_page words",
    "maths": """argument_checks precision over_samples row_runs batch_last scalar lanes
        spatial finite_difference inertial_parameters charts noise gates sample_weight kalman_forms fused_update kalman
        innovation_tests least_squares""",
    "logs": "npz plain_file atomic_files schema unwrap joint_names as_model log findings readers log_files chunks",
    "logs.readers": """stamps registers options messages streams bag_messages bag_targets
        bag_collect bag column_plan column_names columns
        delimited normalised arrow_columns parquet arrays_by_name export""",
    "logs.readers.messages": "protobuf plain control robots",
    "model": """mujoco_types joint_inertia mujoco_warnings file_safety model_errors robot geometry finite_numbers
        urdf_text urdf_read shapes descriptions spec urdf_write load robot_spec lock joint_match write
        log_match""",
    "dynamics": "kinematics sparse_rows recursions rigid_body",
    "signals": """bands held filtering generalised_motion differences dry_friction ground base_motion
        wrench_axes spikes outliers creep torque_residual window_mean errors_in_variables holds misfit
        corrections sensor_noise""",
    "signals.ground": "sinking stance support errors",
    "preflight": """units single_channel cross_channel position_targets torque_parts joint_ranges compared
        other_readings own_numbers gravity_readings column_order position_readings against_model mended preflight
        drive_gains""",
    "estimation": """priors physical_estimate filter_settings joint_terms inertial_filter online
        batch_rows wrist_sensor batch_solve batch_fit pieces log_filter stream checkpoint
        identifiability suggest held_load log_estimate estimate_inputs pipeline""",
    "estimation.suggest": "motion_limits excitation",
    "estimation.online": "slew exact_memory load_bank exported_step",
    "maths.scalar": "program trace c_source",
    "control": "payload qp terms whole_body walking composite",
    "robots": "mjcf_elements nadia_figures humanoid_looks humanoid arm pendulum",
    "likelihood": "motion linearised response drive columns evidence rows closed_loop fit batch",
    "replay": """loop joint_numbers record simulation fitting result remainder checks search listing step_law corrected
        handover proof command inputs pipeline output entry""",
    "replay.simulation": "spec_edits model_edits plant stepped simulate",
    "replay.fitting": "errors columns problem start fit file_form draws",
    "replay.output": "figures policy report recording",
    "replay.search": """ties parsimony causal unnamed held_out candidates tries elsewhere by_law afresh entries
        closed_loop odd exchange undecided instead clock possible probability choice""",
    "trainers": "exports",
    "fleet": "running report_file numbers drift page jobs",
    "cli": """console running conventions conversion command_page replay_run replay
        diagnose_output diagnose_run diagnose plots estimate_output estimate_wrench estimate
        suggest_motion compare fleet watch demo main""",
    "cli.running": "compiled stages",
    "cli.conversion": "options command",
    "cli.demo": "simulation hidden comparison figure command",
    "diagnosis": """features effects friction_curve result simulate settings residual hypothesis search
        detectability verdict checks certainty report corrected calibration_state conclusion
        pipeline entry""",
    "diagnosis.certainty": "rivals causes probability doubts",
    "diagnosis.conclusion": "listing stated_causes summary",
    "diagnosis.corrected": """baseline physical_bounds motor_gains unusual_numbers friction_laws intervals
        covariance handed_over""",
    "diagnosis.features": "derivatives two_mass context",
    "diagnosis.effects": """identified spec_joint couplings advice base actuator joint dry_friction friction_forms
        encoder environment external_force generic generic_forms inertial ground tolerances
        transmission registry""",
    "diagnosis.simulate": "step_law corrected plant rollout whole_robot",
    "diagnosis.report": """gap_stretches where wording next_motion detectable_sizes drawing figures json_values
        json_report page""",
    "diagnosis.search": """bank discrepancy evidence best_numbers sensor_noise pushes candidates ordinary selection
        one_more stepwise refuted_tolerances""",
}
RANK = {folder: {n: i for i, n in enumerate(text.split())} for folder, text in ORDER.items()}
# Leaves: nothing but the command line may need a controller or a robot made up for a demonstration.
LEAVES = {"control": {"control", "cli"}, "robots": {"robots", "cli"}}
# Folders that know no simulator.
PLAIN = {"text", "maths", "logs", "signals", "preflight"}
MOST_MODULES = 20
MOST_LINES = 60


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


def fork(one: str, other: str) -> tuple[str, str, str]:
    """The folder in which the ways to two modules part, and what is next on each way there ("" at its end)."""
    a, b = one.split("."), other.split(".")
    same = next(
        (i for i, (x, y) in enumerate(zip(a, b, strict=False)) if x != y), min(len(a), len(b))
    )
    return ".".join(a[:same]), *("".join(parts[same : same + 1]) for parts in (a, b))


def upward(name: str, imported: set[str]) -> list[str]:
    """One line for each import that points up, or into a leaf."""
    lines = []
    for other in sorted(imported):
        folder, own, top = fork(name, other)
        rank = RANK.get(folder, {})
        # What has no place yet is for `test_every_module_has_its_place` to report.
        if own in rank and top in rank and rank[top] > rank[own]:
            lines.append(
                f"{name} imports {other}, which comes after it in {folder or PACKAGE.name}"
            )
        root = name.partition(".")[0]
        if root not in LEAVES.get(other.partition(".")[0], {root}):
            lines.append(f"{name} imports {other}, which is a leaf")
    return lines


GRAPH = {name: path.read_text() for name, path in MODULES.items() if name}


def test_every_module_has_its_place():
    for name in GRAPH:
        folder, _, last = name.rpartition(".")
        assert last in RANK[folder], f"give {name} a place in the order of {folder or PACKAGE.name}"
    every = {f"{f}.{n}".strip(".") for f, names in RANK.items() for n in names}
    assert sorted(every - GRAPH.keys()) == [], "these are gone"


@pytest.mark.parametrize("name", GRAPH)
def test_imports_point_down(name):
    assert upward(name, imports_of(name, GRAPH[name])) == []


def test_no_cycles():
    graph = {name: imports_of(name, source) - {name} for name, source in GRAPH.items()}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail("modules import each other: " + " → ".join(error.args[1]))


def test_no_folder_is_a_heap():
    assert [f for f, names in RANK.items() if len(names) > MOST_MODULES] == []


def code_lines(function: ast.FunctionDef, source: list[str]) -> int:
    """Lines of a function without its docstring, comments and empty ones."""
    first = function.body[0]
    text = set()
    if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant):
        text = set(range(first.lineno, (first.end_lineno or 0) + 1))
    every = set(range(function.lineno, (function.end_lineno or 0) + 1)) - text
    lines = [source[k - 1].strip() for k in every]
    return sum(1 for line in lines if line and not line.startswith("#"))


def test_no_function_is_long():
    long = {
        f"{name}.{node.name}": count
        for name, source in GRAPH.items()
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.FunctionDef)
        and (count := code_lines(node, source.splitlines())) > MOST_LINES
    }
    assert long == {}, "split these"
    example = 'def f():\n    """Text."""\n\n    # Why.\n    return 1\n'
    [function] = ast.parse(example).body
    assert isinstance(function, ast.FunctionDef)
    assert code_lines(function, example.splitlines()) == 2


@pytest.mark.parametrize("name", [n for n in GRAPH if n.partition(".")[0] in PLAIN])
def test_logs_and_maths_know_no_simulator(name):
    tree = ast.parse(GRAPH[name])
    names = {a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names}
    names |= {n.module for n in ast.walk(tree) if isinstance(n, ast.ImportFrom) and n.module}
    assert not any(n.partition(".")[0] == "mujoco" for n in names)


def test_the_rules_can_fail():
    def says(name: str, source: str) -> list[str]:
        return upward(name, imports_of(name, source))

    assert says("maths.kalman", "from jax_inertia.model import robot")
    assert says("dynamics.rigid_body", "def f():\n    from jax_inertia.diagnosis.pipeline import A")
    assert says("maths.spatial", "from jax_inertia.maths.kalman import update")
    assert says("logs.log", "from jax_inertia.logs.readers.options import Options")
    assert says("diagnosis.pipeline", "import jax_inertia.robots.arm")
    assert not says("diagnosis.pipeline", "import jax_inertia.dynamics.rigid_body")
    assert not says("logs.log_files", "from jax_inertia.logs.readers.bag import read")
    with pytest.raises(AssertionError, match="import from modules"):
        imports_of("diagnosis.pipeline", "from jax_inertia import load_model")
    with pytest.raises(AssertionError, match="relative"):
        imports_of("diagnosis.pipeline", "from . import context")
