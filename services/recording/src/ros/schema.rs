//! Message definitions, as the `.msg` texts that every reader of the recording gets along with it.

/// A message type.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Schema {
    /// Full name, `package/msg/Type`.
    pub name: &'static str,
    text: &'static str,
    /// Types it is made of, in the order in which they are needed.
    needs: &'static [(&'static str, &'static str)],
}

const TIME: (&str, &str) = ("builtin_interfaces/Time", include_str!("../../msg/builtin_interfaces/Time.msg"));
const HEADER: (&str, &str) = ("std_msgs/Header", include_str!("../../msg/std_msgs/Header.msg"));
const STAMPED: &[(&str, &str)] = &[HEADER, TIME];

/// Positions, velocities and efforts by joint name: what every ROS tool plots.
pub const JOINT_STATE: Schema = Schema {
    name: "sensor_msgs/msg/JointState",
    text: include_str!("../../msg/sensor_msgs/JointState.msg"),
    needs: STAMPED,
};
/// Measured signals beyond position and torque.
pub const MEASURED_DETAIL: Schema = Schema {
    name: "lacuna_msgs/msg/MeasuredDetail",
    text: include_str!("../../msg/lacuna_msgs/MeasuredDetail.msg"),
    needs: STAMPED,
};
/// Acceleration and standard deviations of the smoother.
pub const MOTION_DETAIL: Schema = Schema {
    name: "lacuna_msgs/msg/MotionDetail",
    text: include_str!("../../msg/lacuna_msgs/MotionDetail.msg"),
    needs: STAMPED,
};
/// Payload mass.
pub const PAYLOAD: Schema =
    Schema { name: "lacuna_msgs/msg/Payload", text: include_str!("../../msg/lacuna_msgs/Payload.msg"), needs: STAMPED };
/// Where and when the residual leaves what the model and its noise allow.
pub const RESIDUAL_WATCH: Schema = Schema {
    name: "lacuna_msgs/msg/ResidualWatch",
    text: include_str!("../../msg/lacuna_msgs/ResidualWatch.msg"),
    needs: STAMPED,
};
/// Samples that are missing.
pub const GAP: Schema =
    Schema { name: "lacuna_msgs/msg/Gap", text: include_str!("../../msg/lacuna_msgs/Gap.msg"), needs: STAMPED };
/// Sequence, flags and latencies.
pub const STATUS: Schema =
    Schema { name: "lacuna_msgs/msg/Status", text: include_str!("../../msg/lacuna_msgs/Status.msg"), needs: STAMPED };

impl Schema {
    /// The definition with those of all types it is made of, in the `ros2msg` form: each one after a line of
    /// 80 `=` and `MSG: package/Type`.
    pub fn definition(&self) -> String {
        let mut all = self.text.to_owned();
        for (name, text) in self.needs {
            all.push_str(&"=".repeat(80));
            all.push_str(&format!("\nMSG: {name}\n{text}"));
        }
        all
    }
}
