//! Names of enums without data.

/// Declares an enum with `as_str` and `ALL`, or implements these for an enum. The same names are used in JSON, in the database and on the command line.
macro_rules! names {
    ($(#[$about:meta])* $visible:vis enum $name:ident { $($(#[$doc:meta])* $variant:ident = $text:literal),+ $(,)? }) => {
        $(#[$about])*
        $visible enum $name {
            $($(#[$doc])* $variant),+
        }

        $crate::wire::names!($name { $($variant = $text),+ });
    };
    ($name:ident { $($variant:ident = $text:literal),+ $(,)? }) => {
        impl $name {
            /// Every variant.
            pub const ALL: [Self; [$($text),+].len()] = [$(Self::$variant),+];

            /// Its name.
            pub fn as_str(self) -> &'static str {
                match self {
                    $(Self::$variant => $text,)+
                }
            }
        }
    };
}
pub(crate) use names;
