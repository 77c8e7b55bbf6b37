//! Messages on the bus. The type is the meaning: a [`JointMeasured`] cannot be taken for a
//! [`JointSmoothed`], and two layouts that differ in any field name, type or order differ in
//! [`Wire::LAYOUT_HASH`] and so in the type name on the bus (the bus alone compares only name, size and
//! alignment, and would open two different structs of equal size as one).
//!
//! The graph is a chain without joins: each message carries what later stages need of the earlier ones, so a
//! stage has one input. Arrays hold [`MAX_JOINTS`] entries; the first `header.joints` are in use, the rest 0.

/// Most joints a message can carry.
pub const MAX_JOINTS: usize = 8;
/// Most stages a message can pass; later hops are not stamped.
pub const MAX_HOPS: usize = 8;
/// One value per joint.
pub type Joints = [f64; MAX_JOINTS];
/// One stamp per joint [ns].
pub type Stamps = [i64; MAX_JOINTS];
/// One small number per joint.
pub type Words = [u32; MAX_JOINTS];
/// Monotonic clock readings, one per hop.
pub type Hops = [u64; MAX_HOPS];

/// Bits of [`Header::flags`]. Doubt about a sample travels with it; the sample itself is never altered silently.
pub mod flag {
    macro_rules! flags {
        ($($(#[$meta:meta])* $name:ident = $value:expr,)*) => {
            $($(#[$meta])* pub const $name: u32 = $value;)*
            /// All of them with their names.
            pub const ALL: &[(&str, u32)] = &[$((stringify!($name), $name)),*];
        };
    }
    flags! {
        /// Not a sample: the stream ends here. `seq` is one past the last sample.
        END_OF_STREAM = 1,
        /// The stage's internal state was reset at this sample (start of stream, gap, restart after a fault).
        STATE_RESET = 1 << 1,
        /// Samples are missing right before this one (time gap in the recording, or drops on a live bus).
        GAP = 1 << 2,
        /// The reader repaired this sample (spike, wrapped angle); the repair is counted in the recording's report.
        REPAIRED = 1 << 3,
        /// The drive was off: the torque signal does not act on the robot.
        DRIVE_OFF = 1 << 4,
        /// The pose is outside the workspace: no model torque exists, the torque fields are 0.
        UNREACHABLE = 1 << 5,
        /// At least one joint stands still: its friction may hold any torque within ± f_c.
        STANDSTILL = 1 << 6,
        /// The payload estimate is not supported by the motion: read it as unknown.
        NOT_EXCITED = 1 << 7,
        /// The payload estimator saw a pick or place here and opened its gain.
        PAYLOAD_STEP = 1 << 8,
        /// The smoothed value had less future than the configured lag (end of stream or before a gap).
        SHORT_LAG = 1 << 9,
        /// The joint torque residual left the band that the model and its noise allow.
        MISMATCH = 1 << 10,
    }
}

/// Values of [`ResidualWatch::region_variable`](crate::ResidualWatch::region_variable): what the mismatch depends on.
pub mod region {
    /// On none of the others: it is told by its time alone.
    pub const TIME: u32 = 0;
    /// Joint velocity [rad/s].
    pub const VELOCITY: u32 = 1;
    /// Joint position [rad].
    pub const POSITION: u32 = 2;
    /// Model torque [Nm].
    pub const LOAD: u32 = 3;
}

/// One field of a message, for layout checks and for generating definitions in other languages.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Field {
    /// Field name.
    pub name: &'static str,
    /// Type as written in the declaration.
    pub ty: &'static str,
    /// Offset in bytes.
    pub offset: usize,
    /// Size in bytes.
    pub size: usize,
}

/// A message that may cross process boundaries in shared memory.
///
/// # Safety
/// The type must be `#[repr(C)]`, free of pointers and padding-dependent meaning, valid for every bit
/// pattern, and `LAYOUT_HASH` must change with any change of layout. Declare messages with the `wire!`
/// macro of this module, which guarantees it.
#[expect(unsafe_code, reason = "an unsafe trait states the shared-memory contract; nothing unsafe is done here")]
pub unsafe trait Wire: Copy + Default + std::fmt::Debug + Send + Sync + 'static {
    /// Name of the message, stable across refactorings (it is part of the wire format).
    const NAME: &'static str;
    /// Hash over names, types, offsets and sizes of all fields, the header's included.
    const LAYOUT_HASH: u64;
    /// The fields in order.
    const FIELDS: &'static [Field];
    /// The common header.
    fn header(&self) -> &Header;
    /// The common header, writable.
    fn header_mut(&mut self) -> &mut Header;

    /// Type name on the bus: message name and layout hash.
    fn type_name() -> String {
        format!("lacuna.{}.{:016x}", Self::NAME, Self::LAYOUT_HASH)
    }
}

const FNV_OFFSET: u64 = 0xcbf2_9ce4_8422_2325;

const fn fnv1a(mut hash: u64, bytes: &[u8]) -> u64 {
    let mut i = 0;
    while i < bytes.len() {
        hash = (hash ^ bytes[i] as u64).wrapping_mul(0x0100_0000_01b3);
        i += 1;
    }
    hash
}

/// FNV-1a over the fields of a message, seeded with the header's hash.
const fn layout_hash(name: &str, fields: &[Field], seed: u64) -> u64 {
    let mut hash = fnv1a(seed, name.as_bytes());
    let mut i = 0;
    while i < fields.len() {
        hash = fnv1a(hash, fields[i].name.as_bytes());
        hash = fnv1a(hash, b":");
        hash = fnv1a(hash, fields[i].ty.as_bytes());
        hash = fnv1a(hash, &(fields[i].offset as u64).to_le_bytes());
        hash = fnv1a(hash, &(fields[i].size as u64).to_le_bytes());
        i += 1;
    }
    hash
}

/// What a message is made of, for definitions in other languages.
#[derive(Debug, Clone, Copy)]
pub struct Definition {
    /// Name of the message.
    pub name: &'static str,
    /// Type name on the bus: message name and layout hash.
    pub type_name: fn() -> String,
    /// Size in bytes.
    pub size: usize,
    /// The fields in order, the header first.
    pub fields: &'static [Field],
}

macro_rules! fields {
    ($owner:ident { $($field:ident : $ty:ty),* }) => {
        &[$(Field {
            name: stringify!($field),
            ty: stringify!($ty),
            offset: std::mem::offset_of!($owner, $field),
            size: size_of::<$ty>(),
        }),*]
    };
}

/// Declares messages: the struct, its field table and its layout hash from one list.
macro_rules! wire {
    ($($(#[$meta:meta])* pub struct $name:ident { $($(#[$fmeta:meta])* pub $field:ident : $ty:ty,)* })*) => {
        /// All messages, in the order of the graph.
        pub const MESSAGES: &[Definition] = &[$(Definition {
            name: $name::NAME,
            type_name: $name::type_name,
            size: size_of::<$name>(),
            fields: $name::FIELDS,
        }),*];
        $(
        $(#[$meta])*
        #[repr(C)]
        #[derive(Debug, Clone, Copy, Default, PartialEq)]
        pub struct $name {
            /// Sequence, stamps and flags.
            pub header: Header,
            $($(#[$fmeta])* pub $field: $ty,)*
        }
        #[expect(unsafe_code, reason = "repr(C), plain numbers, hash over the full field list")]
        // SAFETY: repr(C) of u32, u64, i64, f64 and arrays of them; every bit pattern is valid; the hash
        // covers every field and the header.
        unsafe impl Wire for $name {
            const NAME: &'static str = stringify!($name);
            const FIELDS: &'static [Field] = fields!($name { header: Header $(, $field: $ty)* });
            const LAYOUT_HASH: u64 = layout_hash(Self::NAME, Self::FIELDS, HEADER_HASH);
            fn header(&self) -> &Header { &self.header }
            fn header_mut(&mut self) -> &mut Header { &mut self.header }
        }
        )*
    };
}

/// What every message begins with.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Header {
    /// Sequence number given by the source: 1, 2, 3, … without holes. Kept by every stage.
    pub seq: u64,
    /// Measurement time [ns] on the recording's own clock (for live input: nanoseconds since the epoch).
    pub stamp_ns: i64,
    /// Time between this measurement and the newest one that shaped it [ns]: the smoother's lag.
    pub lag_ns: u64,
    /// Samples dropped upstream since the start, all hops together (live edges only).
    pub dropped: u64,
    /// Number of joints in use.
    pub joints: u32,
    /// See [`flag`].
    pub flags: u32,
    /// How many stages have published this sample, the source included.
    pub hops: u32,
    /// How often stages on the way have been restarted since the run began.
    pub restarts: u32,
    /// CLOCK_MONOTONIC when hop i published [ns]; 0 beyond `hops`.
    pub hop_ns: Hops,
}

impl Header {
    /// The fields in order, for definitions in other languages.
    pub const FIELDS: &'static [Field] = fields!(Header {
        seq: u64,
        stamp_ns: i64,
        lag_ns: u64,
        dropped: u64,
        joints: u32,
        flags: u32,
        hops: u32,
        restarts: u32,
        hop_ns: Hops
    });

    /// True if all bits of `mask` are set in the flags.
    pub fn has(&self, mask: u32) -> bool {
        self.flags & mask == mask
    }
}

const HEADER_HASH: u64 = layout_hash("Header", Header::FIELDS, FNV_OFFSET);

wire! {
    /// A measured sample, as the source read it. Published by the source.
    pub struct JointMeasured {
        /// Joint positions [rad] (prismatic: m).
        pub q_rad: Joints,
        /// Joint torques [Nm], or the robot file's `torque_unit`.
        pub tau_nm: Joints,
        /// Joint temperatures [°C]; NaN where there is no such column.
        pub temperature_degc: Joints,
        /// Link-side (second) encoder positions [rad]; NaN where there is no such column.
        pub link_q_rad: Joints,
        /// Joint torque sensor [Nm]; NaN where there is no such column.
        pub link_tau_nm: Joints,
    }

    /// Position, velocity and acceleration with their standard deviations. Published by the smoother.
    pub struct JointSmoothed {
        /// Smoothed position θ [rad].
        pub q_rad: Joints,
        /// Velocity θ̇ [rad/s].
        pub qd_rad_s: Joints,
        /// Acceleration θ̈ [rad/s²].
        pub qdd_rad_s2: Joints,
        /// Standard deviation of θ [rad].
        pub sd_q_rad: Joints,
        /// Standard deviation of θ̇ [rad/s].
        pub sd_qd_rad_s: Joints,
        /// Standard deviation of θ̈ [rad/s²].
        pub sd_qdd_rad_s2: Joints,
        /// Measured torque τ at the same stamp [Nm or `torque_unit`].
        pub tau_nm: Joints,
        /// Temperature at the same stamp [°C]; NaN where absent.
        pub temperature_degc: Joints,
    }

    /// Rigid-body torque of the model. Published by the torque stage.
    pub struct TorqueModel {
        /// Smoothed position θ [rad].
        pub q_rad: Joints,
        /// Velocity θ̇ [rad/s].
        pub qd_rad_s: Joints,
        /// Acceleration θ̈ [rad/s²].
        pub qdd_rad_s2: Joints,
        /// Measured torque τ [Nm or `torque_unit`].
        pub tau_nm: Joints,
        /// Temperature [°C]; NaN where absent.
        pub temperature_degc: Joints,
        /// Torque of the robot file's nominal model [Nm] (Delta: M_KH).
        pub tau_nominal_nm: Joints,
        /// Torque of the identified rigid-body model [Nm] (Delta: M_Id); equals the nominal one without a model file.
        pub tau_rigid_nm: Joints,
        /// ∂τ/∂m_p at this motion [Nm/kg]: Jᵀγ for the Delta, the tip-mass column for serial arms.
        pub payload_column_nm_kg: Joints,
    }

    /// Friction and further terms. Published by the friction stage.
    pub struct FrictionTorque {
        /// Smoothed position θ [rad].
        pub q_rad: Joints,
        /// Velocity θ̇ [rad/s].
        pub qd_rad_s: Joints,
        /// Measured torque τ [Nm or `torque_unit`].
        pub tau_nm: Joints,
        /// Nominal rigid-body torque [Nm] (M_KH).
        pub tau_nominal_nm: Joints,
        /// Identified rigid-body torque [Nm] (M_Id).
        pub tau_rigid_nm: Joints,
        /// Friction and all further terms of the model file [Nm] (the F of M_Id+F).
        pub tau_friction_nm: Joints,
        /// ∂τ/∂m_p [Nm/kg].
        pub payload_column_nm_kg: Joints,
        /// Bit i set: joint i stands still, its friction is indeterminate within ± f_c.
        pub standstill: u32,
        /// Always 0; keeps the size a multiple of 8 without hidden padding.
        pub reserved: u32,
    }

    /// Payload mass and what is left after it. Published by the payload stage.
    pub struct PayloadEstimate {
        /// Smoothed position θ [rad].
        pub q_rad: Joints,
        /// Velocity θ̇ [rad/s].
        pub qd_rad_s: Joints,
        /// Measured torque τ [Nm or `torque_unit`].
        pub tau_nm: Joints,
        /// Model torque without payload [Nm]: rigid body + friction + terms (M_Id+F, m_p = 0).
        pub tau_model_nm: Joints,
        /// τ − τ_model with m_p = 0 [Nm].
        pub residual_nm: Joints,
        /// τ − τ_model − m̂_p Jᵀγ [Nm].
        pub residual_payload_nm: Joints,
        /// Payload mass m̂_p [kg]; read it only where `flag::NOT_EXCITED` is clear.
        pub mass_kg: f64,
        /// Standard deviation of m̂_p [kg].
        pub sd_mass_kg: f64,
    }

    /// Where and when the residual leaves what the model and its noise allow. Published by the monitor.
    pub struct ResidualWatch {
        /// Mean residual of the joint's last complete block [Nm].
        pub residual_nm: Joints,
        /// Standard deviation that the model and its noise allow it [Nm]; 0 where none is known.
        pub sd_nm: Joints,
        /// Evidence of a mismatch as a share of the alarm's threshold: 1 and more is an alarm.
        pub score: Joints,
        /// Stamp since which the evidence grows [ns]: the estimated onset. Only where `score` > 0.
        pub since_ns: Stamps,
        /// Lower end of the region where the mismatch is, in the unit of `region_variable`. Only under an alarm.
        pub region_low: Joints,
        /// Upper end of it.
        pub region_high: Joints,
        /// Which variable the region is in, see [`region`].
        pub region_variable: Words,
        /// Bit i set: joint i is under alarm.
        pub alarm: u32,
        /// Bit i set: joint i is watched (its noise is known).
        pub watched: u32,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn no_padding(message: &Definition) {
        let sum: usize = message.fields.iter().map(|f| f.size).sum();
        assert_eq!(sum, message.size, "{} has hidden padding", message.name);
        for pair in message.fields.windows(2) {
            assert_eq!(pair[0].offset + pair[0].size, pair[1].offset, "{}", message.name);
        }
    }

    #[test]
    fn messages_have_no_padding() {
        let sum: usize = Header::FIELDS.iter().map(|f| f.size).sum();
        assert_eq!(sum, size_of::<Header>());
        for message in MESSAGES {
            no_padding(message);
        }
    }

    #[test]
    fn layout_hash_sees_names_types_and_order() {
        let f = |name, ty, offset| Field { name, ty, offset, size: 8 };
        let a = [f("a", "f64", 0), f("b", "u64", 8)];
        let renamed = [f("x", "f64", 0), f("b", "u64", 8)];
        let retyped = [f("a", "i64", 0), f("b", "u64", 8)];
        let swapped = [f("b", "u64", 0), f("a", "f64", 8)];
        let hash = |fields: &[Field]| layout_hash("M", fields, HEADER_HASH);
        for other in [&renamed, &retyped, &swapped] {
            assert_ne!(hash(&a), hash(other));
        }
        assert_ne!(hash(&a), layout_hash("N", &a, HEADER_HASH));
        // TorqueModel and JointSmoothed have equal size: the case the bus alone would not notice.
        assert_eq!(size_of::<TorqueModel>(), size_of::<JointSmoothed>());
        assert_ne!(TorqueModel::type_name(), JointSmoothed::type_name());
    }
}
