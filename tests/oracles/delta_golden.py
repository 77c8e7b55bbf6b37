#!/usr/bin/env python3
"""Goldens for the Delta's kinematics and inverse dynamics, from bodies and constraints.

    python3 tests/oracles/delta_golden.py services/physics/tests/golden/delta.json

Needs numpy, pin (Pinocchio) and mujoco. The Delta is built as a machine, not as an equation: three upper
arms on hinges, six rods on universal joints at the elbows, a platform with six degrees of freedom (21 in
all), and 18 loop equations "rod end = ball on the platform". Newton's method closes the loops; velocities and
accelerations follow from the loop Jacobian; the torque is the tree's inverse dynamics projected on the
three hinges, tau = T^T rnea(q, v, a) with v = T qd. That the platform does not rotate is a result here.

Every torque is computed by Pinocchio and again by MuJoCo on a model written independently (MJCF); the script
stops if they differ by more than 1e-9 relative.
"""

import json
import sys

import mujoco
import numpy as np
import pinocchio as pin

HALF_SPREAD = 0.06  # half the distance between the two rods of a leg [m]


class Robot:
    """Physical description: upper arms as general bodies, rods as slender bodies."""

    def __init__(self, geometry, mass, gravity, rods=None, arms=None):
        self.l1, self.l2, self.ra, self.rb, self.alpha_deg = geometry
        self.m0, self.m1, self.m2, self.jr = mass
        self.gravity = np.array(gravity)
        self.rods = rods  # (leg mass, com fraction, leg inertia across) or None for lumped point masses
        self.arms = arms  # per leg (mass, com along, com across, inertia about the hinge) or None for rods m1
        self.alpha = np.deg2rad(self.alpha_deg)

    def arm(self, i):
        if self.arms:
            return self.arms[i]
        return (self.m1, self.l1 / 2, 0.0, self.m1 * self.l1**2 / 3)

    def elbow_mass(self):
        return 0.0 if self.rods else self.m2

    def platform_mass(self):
        return self.m0 if self.rods else self.m0 + 3 * self.m2

    def parameters(self):
        """Linear parameters by symbol, from the definitions of the first and second moments."""
        out = {}
        leg_mass, xi, inertia = self.rods or (2 * self.m2, 0.5, 0.0)
        turning = inertia / self.l2**2
        if self.rods:
            m_jj = leg_mass * (1 - xi) ** 2 + turning
            m_je = leg_mass * xi * (1 - xi) - turning
            m_ee = leg_mass * xi**2 + turning
            m_j, m_e = leg_mass * (1 - xi), leg_mass * xi
        else:
            m_jj = m_ee = m_j = m_e = self.m2
            m_je = 0.0
        for i in range(3):
            m, along, across, about_hinge = self.arm(i)
            out[f"I{i + 1}"] = about_hinge + m_jj * self.l1**2 + self.jr
            out[f"gc{i + 1}"] = m * along + m_j * self.l1
            out[f"gs{i + 1}"] = m * across
        out["m_in"] = self.m0 + 3 * m_ee
        out["m_gr"] = self.m0 + 3 * m_e
        out["m_JE"] = m_je
        return out


def leg_frame(alpha):
    """Axes of a leg: x outward, y along the hinge, z up."""
    c, s = np.cos(alpha), np.sin(alpha)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def slender(mass, com, across):
    """Inertia of a rod along x with no inertia about its own axis."""
    return pin.Inertia(mass, np.array([com, 0, 0]), np.diag([0.0, across, across]))


class PinDelta:
    """Pinocchio: hinge about +y of the leg frame turns x (outward) towards -z (down) for a positive angle."""

    def __init__(self, robot):
        self.r = robot
        m = self.model = pin.Model()
        m.gravity.linear = robot.gravity
        self.ends, self.balls, self.hinges = [], [], []
        self.offsets = []
        for i in range(3):
            frame = leg_frame(robot.alpha[i])
            place = pin.SE3(frame, frame @ np.array([robot.ra, 0, 0]))
            hinge = m.addJoint(0, pin.JointModelRY(), place, f"hinge{i}")
            mass, along, across, about_hinge = robot.arm(i)
            com = np.array([along, 0, -across])
            central = about_hinge - mass * (along**2 + across**2)
            # Only the inertia about the hinge (y) acts; the others are free choices.
            m.appendBodyToJoint(hinge, pin.Inertia(mass, com, np.diag([central, central, central])), pin.SE3.Identity())
            if robot.elbow_mass():
                point = pin.Inertia(robot.elbow_mass(), np.array([robot.l1, 0, 0]), np.zeros((3, 3)))
                m.appendBodyToJoint(hinge, point, pin.SE3.Identity())
            self.hinges.append(hinge)
            for side in (-1, 1):
                elbow = pin.SE3(np.eye(3), np.array([robot.l1, side * HALF_SPREAD, 0]))
                a = m.addJoint(hinge, pin.JointModelRY(), elbow, f"swing{i}{side}")
                b = m.addJoint(a, pin.JointModelRZ(), pin.SE3.Identity(), f"sway{i}{side}")
                if robot.rods:
                    leg_mass, xi, inertia = robot.rods
                    m.appendBodyToJoint(b, slender(leg_mass / 2, xi * robot.l2, inertia / 2), pin.SE3.Identity())
                end = pin.SE3(np.eye(3), np.array([robot.l2, 0, 0]))
                self.ends.append(m.addFrame(pin.Frame(f"end{i}{side}", b, 0, end, pin.FrameType.OP_FRAME)))
                self.offsets.append(frame @ np.array([robot.rb, side * HALF_SPREAD, 0]))
        slides = m.addJoint(0, pin.JointModelTranslation(), pin.SE3.Identity(), "translation")
        platform = m.addJoint(slides, pin.JointModelSpherical(), pin.SE3.Identity(), "rotation")
        m.appendBodyToJoint(platform, pin.Inertia(robot.platform_mass(), np.zeros(3), np.diag([0.01] * 3)), pin.SE3.Identity())
        for k, offset in enumerate(self.offsets):
            self.balls.append(m.addFrame(pin.Frame(f"ball{k}", platform, 0, pin.SE3(np.eye(3), offset), pin.FrameType.OP_FRAME)))
        self.data = m.createData()
        self.actuated = [m.joints[h].idx_v for h in self.hinges]
        self.passive = [k for k in range(m.nv) if k not in self.actuated]
        assert m.nv == 21 and len(self.passive) == 18

    def loops(self, q):
        pin.forwardKinematics(self.model, self.data, q)
        pin.updateFramePlacements(self.model, self.data)
        pin.computeJointJacobians(self.model, self.data, q)
        gap, jac = np.zeros(18), np.zeros((18, 21))
        for k, (end, ball) in enumerate(zip(self.ends, self.balls)):
            rows = slice(3 * k, 3 * k + 3)
            gap[rows] = self.data.oMf[end].translation - self.data.oMf[ball].translation
            jac[rows] = (
                pin.getFrameJacobian(self.model, self.data, end, pin.LOCAL_WORLD_ALIGNED)[:3]
                - pin.getFrameJacobian(self.model, self.data, ball, pin.LOCAL_WORLD_ALIGNED)[:3]
            )
        return gap, jac

    def close(self, theta):
        """Configuration with closed loops, knees out and the platform below."""
        m = self.model
        q = pin.neutral(m)
        for h, t in zip(self.hinges, theta):
            q[m.joints[h].idx_q] = t
        for i in range(3):
            for side in (-1, 1):
                # Rods start pointing down and inward.
                q[m.joints[m.getJointId(f"swing{i}{side}")].idx_q] = 1.9 - theta[i]
        t = m.joints[m.getJointId("translation")].idx_q
        q[t : t + 3] = [0, 0, -self.r.l2 * 0.8 - self.r.l1 * np.sin(np.mean(theta))]
        for _ in range(100):
            gap, jac = self.loops(q)
            if np.abs(gap).max() < 1e-14:
                break
            dv = np.zeros(m.nv)
            dv[self.passive] = -np.linalg.lstsq(jac[:, self.passive], gap, rcond=None)[0]
            dv *= min(1.0, 0.5 / np.abs(dv).max())
            q = pin.integrate(m, q, dv)
        assert np.abs(self.loops(q)[0]).max() < 1e-13, "loops do not close"
        x = q[t : t + 3]
        assert all(x[2] < -self.r.l1 * np.sin(a) for a in theta), "platform above an elbow"
        return q, x

    def solve(self, theta, rate, accel, force):
        m, d = self.model, self.data
        q, x = self.close(theta)
        _, jac = self.loops(q)
        to_all = np.zeros((21, 3))
        to_all[self.actuated] = np.eye(3)
        to_all[self.passive] = -np.linalg.solve(jac[:, self.passive], jac[:, self.actuated])
        v = to_all @ rate
        # Loop acceleration at zero joint acceleration: the drift that the passive joints must cancel.
        pin.forwardKinematics(m, d, q, v, np.zeros(21))
        drift = np.concatenate(
            [
                pin.getFrameClassicalAcceleration(m, d, e, pin.LOCAL_WORLD_ALIGNED).linear
                - pin.getFrameClassicalAcceleration(m, d, b, pin.LOCAL_WORLD_ALIGNED).linear
                for e, b in zip(self.ends, self.balls)
            ]
        )
        a = to_all @ accel
        a[self.passive] -= np.linalg.solve(jac[:, self.passive], drift)
        t = m.joints[m.getJointId("translation")].idx_v
        spin = v[t + 3 : t + 6]
        assert np.abs(spin).max() < 1e-9, f"platform rotates: {spin}"
        jp = to_all[t : t + 3]
        tau = to_all.T @ pin.rnea(m, d, q, v, a) + self.r.jr * accel - jp.T @ force
        return {"q": q, "v": v, "a": a, "to_all": to_all, "x": x, "xd": v[t : t + 3], "xdd": a[t : t + 3], "jp": jp, "tau": tau}


def mujoco_delta(r):
    """The same machine as MJCF, joints in the same order as Pinocchio's."""
    quat = lambda alpha: f"{np.cos(alpha / 2)} 0 0 {np.sin(alpha / 2)}"
    fmt = lambda v: " ".join(repr(float(x)) for x in v)
    body = []
    for i in range(3):
        mass, along, across, about_hinge = r.arm(i)
        central = about_hinge - mass * (along**2 + across**2)
        # One body holds one inertial: lump the elbow's point mass into it.
        me = r.elbow_mass()
        total = mass + me
        com = (mass * np.array([along, 0, -across]) + me * np.array([r.l1, 0, 0])) / total
        def shifted(m, c):
            d = c - com
            return m * (d @ d * np.eye(3) - np.outer(d, d))
        inertia = central * np.eye(3) + shifted(mass, np.array([along, 0, -across])) + shifted(me, np.array([r.l1, 0, 0]))
        full = [inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1], inertia[0, 2], inertia[1, 2]]
        place = leg_frame(r.alpha[i]) @ np.array([r.ra, 0, 0])
        body.append(f'<body pos="{fmt(place)}" quat="{quat(r.alpha[i])}"><joint name="hinge{i}" type="hinge" axis="0 1 0"/>')
        body.append(f'<inertial pos="{fmt(com)}" mass="{total!r}" fullinertia="{fmt(full)}"/>')
        for side in (-1, 1):
            if r.rods:
                leg_mass, xi, across_i = r.rods
                rod = (leg_mass / 2, xi * r.l2, across_i / 2)
            else:
                rod = (1e-15, r.l2 / 2, 1e-15)
            body.append(f'<body pos="{fmt([r.l1, side * HALF_SPREAD, 0])}"><joint type="hinge" axis="0 1 0"/><joint type="hinge" axis="0 0 1"/>')
            body.append(f'<inertial pos="{fmt([rod[1], 0, 0])}" mass="{rod[0]!r}" diaginertia="1e-15 {rod[2]!r} {rod[2]!r}"/></body>')
        body.append("</body>")
    body.append('<body name="platform"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/><joint type="slide" axis="0 0 1"/><joint type="ball"/>')
    body.append(f'<inertial pos="0 0 0" mass="{r.platform_mass()!r}" diaginertia="0.01 0.01 0.01"/></body>')
    xml = (
        f'<mujoco><compiler angle="radian" boundmass="0" balanceinertia="false"/>'
        f'<option gravity="{fmt(r.gravity)}"><flag contact="disable" constraint="disable"/></option>'
        f'<worldbody>{"".join(body)}</worldbody></mujoco>'
    )
    return mujoco.MjModel.from_xml_string(xml)


def mujoco_torque(model, r, s, accel, force):
    """Tree torque of the same motion in MuJoCo, projected with the same T."""
    data = mujoco.MjData(model)
    data.qpos[:18], data.qvel[:], data.qacc[:] = s["q"][:18], s["v"], s["a"]
    data.qpos[18:] = [1, 0, 0, 0]  # Pinocchio's quaternion is xyzw, MuJoCo's wxyz; the platform does not turn
    mujoco.mj_inverse(model, data)
    return s["to_all"].T @ data.qfrc_inverse + r.jr * accel - s["jp"].T @ force


def toml(r):
    return "\n".join(
        [
            'kind = "delta"',
            'name = "golden"',
            "[geometry]",
            f"l1 = {r.l1!r}\nl2 = {r.l2!r}\nra = {r.ra!r}\nrb = {r.rb!r}",
            f"alpha_deg = {[float(a) for a in r.alpha_deg]!r}",
            "[mass]",
            f"platform = {r.m0!r}\nupper_arm = {r.m1!r}\nforearm_point = {r.m2!r}\nrotor_inertia = {r.jr!r}",
            f"[env]\ngravity = {[float(g) for g in r.gravity]!r}",
            "",
        ]
    )


def main(path):
    rng = np.random.default_rng(20240511)
    even = (0.35, 0.88, 0.2, 0.05, [0.0, 120.0, 240.0])
    uneven = (0.22, 0.6, 0.16, 0.06, [10.0, 125.0, 250.0])
    level = [0, 0, -9.81]
    tilted = [0.9, -0.4, -9.7]
    masses = (1.1, 1.8, 0.22, 0.06)
    arms = [(1.5, 0.12, 0.013, 0.06), (1.7, 0.1, -0.02, 0.055), (1.6, 0.11, 0.004, 0.05)]
    cases = {
        "lumped": Robot(even, masses, level),
        "lumped_uneven_tilted": Robot(uneven, (0.4, 0.7, 0.1, 0.01), tilted),
        "uniform_forearms": Robot(even, masses, level, rods=(0.44, 0.5, 0.44 * 0.88**2 / 12)),
        "general_tilted": Robot(uneven, (0.8, 0.9, 0.15, 0.02), tilted, rods=(0.35, 0.44, 0.013), arms=arms),
    }
    out, worst = [], 0.0
    for name, r in cases.items():
        pin_model, mj_model = PinDelta(r), mujoco_delta(r)
        states = []
        for _ in range(14):
            theta = rng.uniform(-0.6, 1.1, 3)
            rate, accel = rng.uniform(-8, 8, 3), rng.uniform(-120, 120, 3)
            force = rng.uniform(-30, 30, 3)
            s = pin_model.solve(theta, rate, accel, force)
            other = mujoco_torque(mj_model, r, s, accel, force)
            error = np.abs(other - s["tau"]).max() / np.abs(s["tau"]).max()
            worst = max(worst, error)
            assert error < 1e-9, (name, error)
            states.append(
                {
                    "q": theta.tolist(),
                    "qd": rate.tolist(),
                    "qdd": accel.tolist(),
                    "force": force.tolist(),
                    "tau": s["tau"].tolist(),
                    "x": s["x"].tolist(),
                    "xd": s["xd"].tolist(),
                    "xdd": s["xdd"].tolist(),
                    "jacobian": s["jp"].flatten().tolist(),
                }
            )
        forearm = dict(zip(("mass_kg", "com_fraction", "inertia_kg_m2"), r.rods)) if r.rods else None
        out.append(
            {"name": name, "robot": toml(r), "forearm": forearm, "robot_file_arms": r.arms is None, "parameters": r.parameters(), "states": states}
        )
    with open(path, "w") as f:
        json.dump({"made_by": f"tests/oracles/delta_golden.py, Pinocchio {pin.__version__}, MuJoCo {mujoco.__version__}", "cases": out}, f, indent=0)
        f.write("\n")
    print(f"{path}: {sum(len(c['states']) for c in out)} states; Pinocchio against MuJoCo {worst:.1e} relative")


if __name__ == "__main__":
    main(sys.argv[1])
