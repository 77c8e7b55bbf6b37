#!/usr/bin/env python3
"""Torques that Pinocchio calculates from a URDF: an independent reader and an independent dynamics.

  urdf_torque.py MODEL.urdf MOTIONS.json joint,joint,... rotor,rotor,...

MOTIONS.json is a list of [q, qd, qdd], each a list in the order of the joints; gravity is (0, 0, -9.81). Prints the
torques as a JSON list. Exit code 77 if Pinocchio is not installed.
"""

import json
import math
import sys

try:
    import numpy as np
    import pinocchio as pin
except ImportError:
    sys.exit(77)


def main(urdf, motions, joints, rotors):
    model = pin.buildModelFromUrdf(urdf)
    data = model.createData()
    assert set(model.names) - {"universe"} == set(joints), list(model.names)
    ids = [model.getJointId(name) for name in joints]
    model.armature[:] = 0.0
    out = []
    for q, v, a in json.load(open(motions)):
        state, speed, change = pin.neutral(model), np.zeros(model.nv), np.zeros(model.nv)
        for joint, qi, vi, ai in zip(ids, q, v, a):
            place = model.joints[joint]
            # A joint without limits is a point on the circle.
            state[place.idx_q : place.idx_q + place.nq] = [qi] if place.nq == 1 else [math.cos(qi), math.sin(qi)]
            speed[place.idx_v], change[place.idx_v] = vi, ai
        torque = pin.rnea(model, data, state, speed, change)
        for joint, rotor in zip(ids, rotors):
            torque[model.joints[joint].idx_v] += rotor * change[model.joints[joint].idx_v]
        out.append([torque[model.joints[joint].idx_v] for joint in ids])
    json.dump(out, sys.stdout)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], sys.argv[3].split(","), [float(r) for r in sys.argv[4].split(",")])
