#!/usr/bin/env python3
"""The friction stage in Python: a process that takes the place of `lacuna-friction`.

    lacuna messages --python --out launch/python/lacuna_messages.py
    lacuna up launch/replay.toml --set friction=launch/python/friction.py --set recording=…

    sliding, |v| >= v_s:   tau_f = f_v v + f_c sgn v + offset
    standing, |v| < v_s:   tau_f = f_v v + offset + h,  h = clamp(tau - tau_rigid - f_v v - offset, -f_c, f_c)
"""

import math

from lacuna_messages import DRIVE_OFF, MAX_JOINTS, STANDSTILL, UNREACHABLE, FrictionTorque, TorqueModel
from lacuna_stage import BadInput, run_stage

COPIED = ["q_rad", "qd_rad_s", "tau_nm", "tau_nominal_nm", "tau_rigid_nm", "payload_column_nm_kg"]


class Friction:
    def __init__(self, robot, model, config):
        standstill = config.get("standstill_rad_s", 0.02)
        friction = (model or {}).get("friction", {})
        if (model or {}).get("term"):
            raise BadInput("model file: found a [[term]]; expected friction alone, as this example knows no terms")
        self.joints = len(robot.get("joints", "123"))  # a Delta need not name its three

        def per_joint(key, default):
            values = friction.get(key) or [default] * self.joints
            if not all(math.isfinite(v) and (v >= 0 or key == "offset") for v in values):
                raise BadInput(f"friction.{key}: found {values}; expected zero or positive numbers")
            return values + [default] * (MAX_JOINTS - len(values))

        self.f_v, self.f_c, self.offset = (per_joint(key, 0.0) for key in ("f_v", "f_c", "offset"))
        self.standstill = per_joint("standstill_rad_s", standstill)

    def step(self, sample, out):
        for name in COPIED:
            setattr(out, name, getattr(sample, name))
        out.standstill = 0
        for i in range(self.joints):
            v = sample.qd_rad_s[i] if math.isfinite(sample.qd_rad_s[i]) else 0.0
            slides = abs(v) >= self.standstill[i] and v != 0.0
            tau = self.offset[i] + (self.f_v[i] * v + self.f_c[i] * (math.copysign(1.0, v) if slides else 0.0))
            if not slides:
                out.standstill |= 1 << i
                applied = 0.0 if sample.header.flags & DRIVE_OFF else sample.tau_nm[i]
                held = 0.0 if sample.header.flags & UNREACHABLE else applied - sample.tau_rigid_nm[i] - tau
                tau += 0.0 if math.isnan(held) else max(-self.f_c[i], min(self.f_c[i], held))
            out.tau_friction_nm[i] = tau
        if out.standstill:
            out.header.flags |= STANDSTILL


if __name__ == "__main__":
    run_stage(Friction, TorqueModel, FrictionTorque)
