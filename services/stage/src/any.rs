//! The one list of all messages, for whatever handles any of them.

use lacuna_interfaces::{
    FrictionTorque, Header, JointMeasured, JointSmoothed, PayloadEstimate, ResidualWatch, TorqueModel, Wire,
};

/// Calls the macro `$then` with the names of all messages.
macro_rules! with_messages {
    ($then:ident) => {
        $then!(JointMeasured, JointSmoothed, TorqueModel, FrictionTorque, PayloadEstimate, ResidualWatch);
    };
}
pub(crate) use with_messages;

macro_rules! any_message {
    ($($name:ident),*) => {
        /// A sample of any message the graph knows.
        #[derive(Debug, Clone, Copy)]
        pub enum AnyMessage<'a> {
            $(#[doc = concat!("A [`", stringify!($name), "`].")] $name(&'a $name),)*
        }

        impl AnyMessage<'_> {
            /// The common header.
            pub fn header(&self) -> &Header {
                match self { $(Self::$name(m) => m.header(),)* }
            }
        }
    };
}

with_messages!(any_message);
