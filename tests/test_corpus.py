"""Robots' model files as they ship: mass matrix and inverse dynamics against Pinocchio and MuJoCo, file by file."""

import dataclasses

import jax.numpy as jnp
import pytest

pytest.importorskip("pinocchio")
from benchmarks import corpus

URDF = """<robot name="r"><link name="base"/><link name="arm"><inertial><origin xyz="0 0 0.3"/><mass value="2"/>
 <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.01"/></inertial></link>
 <joint name="hip" type="continuous"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/></joint></robot>"""
MJCF = """<mujoco><worldbody><body name="a" gravcomp="1"><freejoint/><geom size="0.1 0.2" type="capsule"/>
 <body name="b" pos="0 0 0.3"><joint type="ball"/><geom size="0.1 0.2" type="capsule" pos="0.1 0 0"/></body></body>
 </worldbody></mujoco>"""


@pytest.mark.slow
def test_files_are_compared_with_the_other_engine(tmp_path, monkeypatch):
    """And a difference is found: the same file, read by a loader that takes one mass otherwise."""
    (tmp_path / "a.urdf").write_text(URDF)
    (tmp_path / "b.xml").write_text(MJCF)
    (tmp_path / "c.xml").write_text("<mujocoinclude><default/></mujocoinclude>")
    (tmp_path / "d.urdf").write_text(URDF.replace('type="continuous"', 'type="fixed"'))
    (tmp_path / "e.urdf").write_text(URDF.replace("<mass", "<mass><mass"))
    files = corpus.model_files([tmp_path])
    assert [path.name for path in files] == ["a.urdf", "b.xml", "d.urdf", "e.urdf"]
    found = [corpus.outcome(path) for path in files]
    assert [one.what for one in found][:3] == ["agrees", "agrees", "no robot to the other engine"]
    load = corpus.load_model

    def heavier(path):
        robot = load(path)
        return dataclasses.replace(robot, pi=robot.pi.at[0].multiply(jnp.array(1.01)))

    monkeypatch.setattr(corpus, "load_model", heavier)
    assert [corpus.outcome(path).what for path in files[:2]] == ["differs", "differs"]


@pytest.mark.slow
@pytest.mark.parametrize("path", corpus.model_files(), ids=lambda path: path.name)
def test_a_robot_as_it_ships(path):
    """Where `pip install 'jax-inertia[corpus]'` was done; what only one of two readers takes is told by name."""
    one = corpus.outcome(path)
    if one.what == "refused":
        assert one.detail.startswith(str(path))
        assert "\n" not in one.detail
    else:
        assert one.what in ("agrees", "no robot to the other engine"), one.detail
