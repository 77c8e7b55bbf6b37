#!/usr/bin/env python3
"""Goldens for serial chains, from Pinocchio on random chains and random states.

    python3 tests/oracles/serial_golden.py services/physics/tests/golden/serial.json [URDF JOINT,JOINT,…]…

Needs numpy and pin. DH chains are put together joint by joint in Pinocchio; URDF chains are written as URDF text
(revolute, continuous, prismatic, fixed joints between and behind, arbitrary axes, rotated inertial frames)
and read by Pinocchio's own parser. Recorded per state: torque, payload column (the torque with a kilogram at
the tip less the torque without), tip position, rotation, velocity, acceleration, Jacobian and its rate.

URDFs named on the command line are not copied: only states and torques are recorded, under the file's name.
"""

import json
import os
import sys

import numpy as np
import pinocchio as pin


def random_inertial(rng):
    mass = rng.uniform(0.3, 6)
    com = rng.uniform(-0.15, 0.15, 3)
    a = rng.uniform(-0.3, 0.3, (3, 3))
    inertia = 0.05 * a @ a.T + 0.01 * np.eye(3)
    return mass, com, inertia


def six(i):
    return [i[0, 0], i[0, 1], i[0, 2], i[1, 1], i[1, 2], i[2, 2]]


def rot(axis, angle):
    return pin.AngleAxis(angle, np.eye(3)[axis]).toRotationMatrix()


class Chain:
    """A Pinocchio model with its tip frame, rotor inertias and robot file."""

    def __init__(self, model, tip_joint, tip, rotor, toml, urdf=None):
        self.model, self.rotor, self.toml, self.urdf = model, np.array(rotor), toml, urdf
        self.tip = model.addFrame(pin.Frame("the_tip", tip_joint, 0, tip, pin.FrameType.OP_FRAME))
        self.data = model.createData()
        self.loaded = pin.Model(model)
        self.loaded.appendBodyToJoint(tip_joint, pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3))), tip)
        self.loaded_data = self.loaded.createData()

    def config(self, q):
        """Continuous joints are (cos, sin) in Pinocchio."""
        out = np.zeros(self.model.nq)
        for joint in list(self.model.joints)[1:]:
            angle = q[joint.idx_v]
            out[joint.idx_q : joint.idx_q + joint.nq] = [np.cos(angle), np.sin(angle)] if joint.nq == 2 else [angle]
        return out

    def state(self, rng):
        n = self.model.nv
        q, qd, qdd = rng.uniform(-2.5, 2.5, n), rng.uniform(-4, 4, n), rng.uniform(-20, 20, n)
        c, m, d = self.config(q), self.model, self.data
        tau = pin.rnea(m, d, c, qd, qdd).copy()
        loaded = pin.rnea(self.loaded, self.loaded_data, c, qd, qdd).copy()
        pin.forwardKinematics(m, d, c, qd, qdd)
        pin.updateFramePlacements(m, d)
        frame = pin.LOCAL_WORLD_ALIGNED
        velocity = pin.getFrameVelocity(m, d, self.tip, frame).linear.copy()
        acceleration = pin.getFrameClassicalAcceleration(m, d, self.tip, frame).linear.copy()
        place = d.oMf[self.tip].copy()
        pin.computeJointJacobiansTimeVariation(m, d, c, qd)
        pin.updateFramePlacements(m, d)
        jac = pin.getFrameJacobian(m, d, self.tip, frame)[:3].copy()
        rate = pin.getFrameJacobianTimeVariation(m, d, self.tip, frame)[:3].copy()
        lists = {
            "q": q, "qd": qd, "qdd": qdd, "tau": tau + self.rotor * qdd, "payload": loaded - tau,
            "x": place.translation, "rotation": place.rotation.flatten(), "xd": velocity, "xdd": acceleration,
            "jacobian": jac.flatten(), "jacobian_rate": rate.flatten(),
        }
        return {k: np.asarray(v).tolist() for k, v in lists.items()}


def head(n, gravity, extra=""):
    names = [f"j{i + 1}" for i in range(n)]
    return (
        f'kind = "serial"\nname = "golden"\njoints = {json.dumps(names)}\n{extra}[env]\ngravity = {[float(g) for g in gravity]!r}\n'
    )


def dh_chain(rng, kinds):
    model = pin.Model()
    gravity = rng.uniform(-9, 9, 3)
    model.gravity.linear = gravity
    text = head(len(kinds), gravity)
    parent, before = 0, pin.SE3.Identity()
    rotor = []
    for i, kind in enumerate(kinds):
        a, d, alpha, offset = rng.uniform(-0.4, 0.4), rng.uniform(-0.3, 0.3), rng.uniform(-3, 3), rng.uniform(-2, 2)
        mass, com, inertia = random_inertial(rng)
        rotor.append(rng.uniform(0, 0.5))
        place = before * pin.SE3(rot(2, offset), np.zeros(3))
        joint = pin.JointModelRZ() if kind == "revolute" else pin.JointModelPZ()
        parent = model.addJoint(parent, joint, place, f"j{i + 1}")
        # Tz(d) Tx(a) Rx(alpha), one after the other.
        before = (
            pin.SE3(np.eye(3), np.array([0, 0, d]))
            * pin.SE3(np.eye(3), np.array([a, 0, 0]))
            * pin.SE3(rot(0, alpha), np.zeros(3))
        )
        model.appendBodyToJoint(parent, pin.Inertia(mass, com, inertia), before)
        text += f'[[dh]]\na = {a!r}\nd = {d!r}\nalpha = {alpha!r}\noffset = {offset!r}\njoint = "{kind}"\n'
        text += f"[[link]]\nmass = {mass!r}\ncom = {com.tolist()!r}\ninertia = {[float(v) for v in six(inertia)]!r}\nrotor_inertia = {rotor[-1]!r}\n"
    return Chain(model, parent, before, rotor, text)


def numbers(v):
    return " ".join(repr(float(x)) for x in v)


def urdf_link(rng, name):
    mass, com, inertia = random_inertial(rng)
    names = ["ixx", "ixy", "ixz", "iyy", "iyz", "izz"]
    values = " ".join(f'{n}="{float(v)!r}"' for n, v in zip(names, six(inertia)))
    return (
        f'<link name="{name}"><inertial><origin xyz="{numbers(com)}" rpy="{numbers(rng.uniform(-2, 2, 3))}"/>'
        f'<mass value="{mass!r}"/><inertia {values}/></inertial></link>\n'
    )


def urdf_joint(rng, name, kind, parent, child):
    axis = f'<axis xyz="{numbers(rng.uniform(-1, 1, 3))}"/>' if kind != "fixed" else ""
    limit = '<limit lower="-9" upper="9" effort="99" velocity="99"/>' if kind in ("revolute", "prismatic") else ""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{numbers(rng.uniform(-0.4, 0.4, 3))}" rpy="{numbers(rng.uniform(-2, 2, 3))}"/>{axis}{limit}</joint>\n'
    )


def urdf_chain(rng, kinds):
    """Kinds may hold "fixed"; a stub hangs on every second moved link, and a flange on the last."""
    text = '<?xml version="1.0"?>\n<robot name="golden">\n<link name="base"/>\n'
    parent, moved = "base", 0
    for i, kind in enumerate(kinds):
        child = f"link{i}"
        name = f"f{i}"
        if kind != "fixed":
            moved += 1
            name = f"j{moved}"
        text += urdf_joint(rng, name, kind, parent, child) + urdf_link(rng, child)
        if i % 2 == 0 and i + 1 < len(kinds):
            text += urdf_joint(rng, f"stub_joint{i}", "fixed", child, f"stub{i}") + urdf_link(rng, f"stub{i}")
        parent = child
    text += urdf_joint(rng, "flange_joint", "fixed", parent, "flange") + '<link name="flange"/>\n</robot>\n'
    model = pin.buildModelFromXML(text)
    gravity = rng.uniform(-9, 9, 3)
    model.gravity.linear = gravity
    assert model.nv == moved and [str(n) for n in model.names][1:] == [f"j{i + 1}" for i in range(moved)]
    flange = model.frames[model.getFrameId("flange")]
    toml = head(moved, gravity, 'urdf = "golden.urdf"\n')
    # A copy: adding the tip frame moves the list that the placement lives in.
    return Chain(model, flange.parentJoint, flange.placement.copy(), np.zeros(moved), toml, text)


def main(path, named):
    rng = np.random.default_rng(7)
    chains = {
        "dh_pendulum": dh_chain(rng, ["revolute"]),
        "dh_six_revolute": dh_chain(rng, ["revolute"] * 6),
        "dh_scara_like": dh_chain(rng, ["revolute", "revolute", "prismatic", "revolute"]),
        "dh_eight_mixed": dh_chain(rng, ["prismatic", "revolute", "revolute", "prismatic", "revolute", "revolute", "revolute", "prismatic"]),
        "urdf_slide": urdf_chain(rng, ["prismatic"]),
        "urdf_six": urdf_chain(rng, ["revolute", "continuous", "revolute", "fixed", "revolute", "continuous", "revolute"]),
        "urdf_seven_mixed": urdf_chain(rng, ["fixed", "prismatic", "revolute", "fixed", "fixed", "prismatic", "continuous", "revolute", "revolute", "prismatic"]),
    }
    out = []
    for name, chain in chains.items():
        states = [chain.state(rng) for _ in range(6)]
        out.append({"name": name, "robot": chain.toml, "urdf": chain.urdf, "states": states})
    files = []
    for file, joints in named:
        model = pin.buildModelFromUrdf(file)
        names = [str(n) for n in model.names][1:]
        assert names == joints, f"{file}: Pinocchio finds {names}"
        bare = Chain(model, model.njoints - 1, pin.SE3.Identity(), np.zeros(model.nv), "")
        states = [{k: v for k, v in bare.state(rng).items() if k in ("q", "qd", "qdd", "tau")} for _ in range(6)]
        folder = os.path.basename(os.path.dirname(os.path.abspath(file)))
        files.append({"urdf": f"{folder}/{os.path.basename(file)}", "joints": joints, "states": states})
    with open(path, "w") as f:
        json.dump({"made_by": f"tests/oracles/serial_golden.py, Pinocchio {pin.__version__}", "chains": out, "files": files}, f)
        f.write("\n")
    print(f"{path}: {len(out)} chains, {len(files)} files")


if __name__ == "__main__":
    main(sys.argv[1], [(sys.argv[i], sys.argv[i + 1].split(",")) for i in range(2, len(sys.argv), 2)])
