#!/usr/bin/env python3
"""Goldens for the simulator's plant, from Pinocchio.

    python tests/oracles/simulate_goldens.py        (needs `pin` and numpy)

Writes services/simulate/tests/goldens/{delta,serial}.txt: lines of `key: numbers`.
Delta: a closed chain of 3 arms, 6 rods on universal joints (real parallelograms) and a translating platform, 18 DoF and
18 loop constraints; inverse dynamics by projecting the tree's RNEA on the constraint's null space.
Serial: aba, crba and nonLinearEffects of a DH arm (built here) and of goldens/arm.urdf, rotors as armature."""
import os
import numpy as np
import pinocchio as pin

HERE = os.path.dirname(os.path.abspath(__file__))
OUT = os.path.join(HERE, "..", "..", "services", "simulate", "tests", "goldens")
G = np.array([0.3, -0.4, -9.7])
rng = np.random.default_rng(20240607)


def line(f, key, *arrays):
    flat = np.concatenate([np.ravel(a) for a in arrays])
    f.write(key + ": " + " ".join(repr(float(v)) for v in flat) + "\n")


# ---------------------------------------------------------------- Delta
ALPHA = np.deg2rad([5.0, 120.0, 243.0])
RA, RB, HALF = 0.2, 0.05, 0.04
L1, L2 = np.array([0.35, 0.36, 0.34]), np.array([0.88, 0.87, 0.89])
ARM = dict(mass=np.array([1.8, 1.9, 1.7]), along=np.array([0.17, 0.19, 0.16]), across=np.array([0.01, -0.02, 0.03]),
           inertia=np.array([0.012, 0.011, 0.013]))  # centre of mass, inertia about it (axis y)
ROD = dict(mass=np.array([0.26, 0.24, 0.25]), xi=np.array([0.47, 0.5, 0.44]), inertia=np.array([0.016, 0.017, 0.015]))
PLATFORM = 1.3
rz = lambda a: pin.utils.rotate("z", a)


def build_delta():
    m = pin.Model()
    m.gravity.linear = G
    arms, rods, ends = [], [], []
    for i in range(3):
        place = pin.SE3(rz(ALPHA[i]), rz(ALPHA[i]) @ np.array([RA, 0, 0]))
        arm = m.addJoint(0, pin.JointModelRY(), place, f"arm{i}")
        # across: the direction of increasing theta at theta = 0 is -z
        com = np.array([ARM["along"][i], 0, -ARM["across"][i]])
        j = ARM["inertia"][i]
        m.appendBodyToJoint(arm, pin.Inertia(ARM["mass"][i], com, np.diag([j / 3, j, j])), pin.SE3.Identity())
        arms.append(arm)
    for i in range(3):
        for side in (-1, 1):
            elbow = pin.SE3(np.eye(3), np.array([L1[i], side * HALF, 0]))
            a = m.addJoint(arms[i], pin.JointModelRX(), elbow, f"rodx{i}{side}")
            b = m.addJoint(a, pin.JointModelRY(), pin.SE3.Identity(), f"rody{i}{side}")
            com = np.array([0, 0, -ROD["xi"][i] * L2[i]])
            j = ROD["inertia"][i]
            m.appendBodyToJoint(b, pin.Inertia(ROD["mass"][i], com, np.diag([j, j, 0.0])), pin.SE3.Identity())
            frame = pin.Frame(f"rod_end{i}{side}", b, 0, pin.SE3(np.eye(3), np.array([0, 0, -L2[i]])), pin.FrameType.OP_FRAME)
            rods.append(m.addFrame(frame))
    platform = m.addJoint(0, pin.JointModelTranslation(), pin.SE3.Identity(), "platform")
    m.appendBodyToJoint(platform, pin.Inertia(PLATFORM, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())
    for i in range(3):
        for side in (-1, 1):
            at = rz(ALPHA[i]) @ np.array([RB, side * HALF, 0])
            ends.append(m.addFrame(pin.Frame(f"on_platform{i}{side}", platform, 0, pin.SE3(np.eye(3), at), pin.FrameType.OP_FRAME)))
    return m, arms, rods, ends


def platform_of(theta):
    """Platform position by Newton iteration on the three rod lengths."""
    x = np.array([0, 0, -0.8])
    elbow = [rz(ALPHA[i]) @ np.array([RA - RB + L1[i] * np.cos(theta[i]), 0, -L1[i] * np.sin(theta[i])]) for i in range(3)]
    for _ in range(50):
        s = np.array([x - e for e in elbow])
        f = (s**2).sum(1) - L2**2
        x = x - np.linalg.solve(2 * s, f)
    return x, elbow


def full_configuration(theta):
    x, elbow = platform_of(theta)
    q = list(theta)
    for i in range(3):
        arm = rz(ALPHA[i]) @ pin.utils.rotate("y", theta[i])
        d = arm.T @ (x - elbow[i]) / L2[i]
        # rod direction = Rx(a) Ry(b) (0, 0, -1) = (-sin b, sin a cos b, -cos a cos b)
        b = -np.arcsin(d[0])
        a = np.arctan2(d[1], -d[2])
        q += [a, b, a, b]
    return np.array(q + list(x))


def delta():
    m, arms, rods, ends = build_delta()
    d = m.createData()
    with open(os.path.join(OUT, "delta.txt"), "w") as f:
        f.write("# Pinocchio %s, tests/oracles/simulate_goldens.py\n" % pin.__version__)
        line(f, "gravity", G)
        line(f, "alpha_rad", ALPHA)
        line(f, "offset", [RA - RB])
        line(f, "l1", L1)
        line(f, "l2", L2)
        i_arm = ARM["inertia"] + ARM["mass"] * (ARM["along"] ** 2 + ARM["across"] ** 2)
        line(f, "arm_inertia", i_arm)
        line(f, "arm_along", ARM["mass"] * ARM["along"])
        line(f, "arm_across", ARM["mass"] * ARM["across"])
        line(f, "forearm_mass", 2 * ROD["mass"])
        line(f, "forearm_centre", ROD["xi"])
        line(f, "forearm_inertia", 2 * ROD["inertia"])
        line(f, "platform", [PLATFORM])
        for _ in range(40):
            theta = rng.uniform(-0.4, 1.3, 3)
            thd, thdd = rng.uniform(-8, 8, 3), rng.uniform(-150, 150, 3)
            q = full_configuration(theta)

            def jacobian_and_drift(v):
                pin.forwardKinematics(m, d, q, v, np.zeros(m.nv))
                pin.computeJointJacobians(m, d, q)
                pin.updateFramePlacements(m, d)
                W = pin.LOCAL_WORLD_ALIGNED
                J, drift, gap = [], [], []
                for r, e in zip(rods, ends):
                    J.append(pin.getFrameJacobian(m, d, r, W)[:3] - pin.getFrameJacobian(m, d, e, W)[:3])
                    drift.append(pin.getFrameClassicalAcceleration(m, d, r, W).linear - pin.getFrameClassicalAcceleration(m, d, e, W).linear)
                    gap.append(d.oMf[r].translation - d.oMf[e].translation)
                return np.vstack(J), np.concatenate(drift), np.abs(np.concatenate(gap)).max()

            J, _, gap = jacobian_and_drift(np.zeros(m.nv))
            assert gap < 1e-10, gap
            passive = np.linalg.pinv(J[:, 3:], rcond=1e-9)
            assert np.linalg.matrix_rank(J[:, 3:], tol=1e-8) == 15
            N = np.vstack([np.eye(3), -passive @ J[:, :3]])
            v = N @ thd
            _, drift, _ = jacobian_and_drift(v)
            a = np.concatenate([thdd, -passive @ (J[:, :3] @ thdd + drift)])
            assert np.abs(J @ a + drift).max() < 1e-8
            tau = N.T @ pin.rnea(m, d, q, v, a)
            line(f, "state", theta, thd, thdd, tau, q[-3:], v[-3:])


# ---------------------------------------------------------------- serial
DH = [(0.1, 0.4, -1.1, 0.2, 0), (0.45, 0.0, 0.3, -1.57, 0), (0.04, 0.1, -1.5, 0.0, 1), (0.0, 0.42, 1.4, 0.5, 0),
      (0.02, 0.0, -1.6, 0.0, 0), (0.05, 0.08, 0.4, -0.3, 0)]  # a, d, alpha, offset, prismatic


def dh_links():
    links = []
    for k in range(6):
        mass = 9.0 / (k + 1)
        com = rng.uniform(-0.1, 0.1, 3)
        r = rng.normal(size=(3, 3)) * 0.1
        links.append((mass, com, mass * (r @ r.T + 0.01 * np.eye(3)), rng.uniform(0.05, 0.3)))
    return links


def states(f, m, kind):
    d = m.createData()
    for _ in range(25):
        q, v = rng.uniform(-1.5, 1.5, m.nv), rng.uniform(-4, 4, m.nv)
        tau = rng.uniform(-60, 60, m.nv)
        a = pin.aba(m, d, q, v, tau)
        M = pin.crba(m, d, q)
        M = np.triu(M) + np.triu(M, 1).T
        h = pin.nonLinearEffects(m, d, q, v)
        assert np.abs(M @ a + h - tau).max() < 1e-8
        line(f, kind, q, v, tau, a, M, h)


def serial():
    with open(os.path.join(OUT, "serial.txt"), "w") as f:
        f.write("# Pinocchio %s, tests/oracles/simulate_goldens.py\n" % pin.__version__)
        line(f, "gravity", G)
        m = pin.Model()
        m.gravity.linear = G
        before = pin.SE3.Identity()
        parent = 0
        links = dh_links()
        for k, ((a, dd, al, off, prismatic), (mass, com, inertia, rotor)) in enumerate(zip(DH, links)):
            turn = pin.SE3(pin.utils.rotate("z", off), np.zeros(3))
            fixed = pin.SE3(pin.utils.rotate("x", al), np.array([a, 0, dd]))
            joint = pin.JointModelPZ() if prismatic else pin.JointModelRZ()
            parent = m.addJoint(parent, joint, before * turn, f"j{k}")
            m.appendBodyToJoint(parent, pin.Inertia(mass, com, inertia), fixed)
            before = fixed
            line(f, "dh", [a, dd, al, off, prismatic])
            line(f, "link", [mass], com, [inertia[0, 0], inertia[0, 1], inertia[0, 2], inertia[1, 1], inertia[1, 2], inertia[2, 2]], [rotor])
        m.armature = np.array([l[3] for l in links])
        states(f, m, "dh_state")
        # A continuous joint has (cos, sin) in Pinocchio's configuration; here it is one angle.
        text = open(os.path.join(OUT, "arm.urdf")).read().replace('"continuous">', '"revolute"><limit lower="-9" upper="9" effort="9" velocity="9"/>')
        m = pin.buildModelFromXML(text)
        assert list(m.names)[1:] == ["j1", "j2", "slide", "j4"], list(m.names)
        m.gravity.linear = G
        states(f, m, "urdf_state")


delta()
serial()
