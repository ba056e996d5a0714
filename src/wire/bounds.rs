//! Bounds of request fields in the OpenAPI document that utoipa's attributes cannot express: bounds of list items, and bounds that are constants of
//! the checks. A test sends values at and beyond every bound of the document.

use crate::kinematics::model::MAX_LINKS;
use crate::measurement::columns::pose::MAX_QUATERNION_OFF;
use crate::measurement::csv::{
    MAX_COORDINATE_MM, MAX_LABEL_LENGTH, MAX_STD_MM, MAX_TEMPERATURE_C, MIN_STD_MM,
};
use crate::measurement::sessions::MAX_SESSIONS;
use crate::wire::compensate::{MAX_TARGET_MM, MAX_TARGETS_PER_REQUEST};
use crate::wire::corrections::MAX_PAYLOAD_OFFSET_MM;
use crate::wire::id::MAX_ID;
use crate::wire::measurement::MAX_JOINT_VALUE_DEG;
use crate::wire::named_frame::MAX_FIXTURE_MM;
use crate::wire::options::MAX_COST_MM2;
use crate::wire::pose_plan::{
    HALF_ANGLE_DEG, MAX_MEASURED, MAX_PLANNED, NOISE_MM, NOISE_ROTATION_DEG,
};
use crate::wire::posture::MAX_POSITION_MM;
use crate::wire::predict::MAX_POSES;
use crate::wire::prior::{MAX_NAMES, MAX_PARAMETER_NAME, MAX_VALUE, MIN_STD};
use crate::wire::robot::{
    GRAVITY_TOLERANCE, MAX_ANGLE_DEG, MAX_COUPLING, MAX_JOINT_DEG, MAX_LENGTH_MM,
};
use crate::wire::tool::ROTATION_TOLERANCE;
use std::ops::RangeInclusive;
use utoipa::Number;
use utoipa::openapi::schema::{ArrayItems, KnownFormat, Object, SchemaFormat};
use utoipa::openapi::{OpenApi, RefOr, Schema};

/// One bound. The bounds of nested lists are given from the outermost list inwards.
enum Bound {
    /// Number of items of a list, minimum and maximum.
    Items(usize, usize),
    /// Value of a number, minimum and maximum.
    Number(f64, f64),
    /// Value of a number, strictly between two others.
    Between(f64, f64),
    /// Number of characters of a text, minimum and maximum.
    Text(usize, usize),
    /// A text that is a time.
    Time,
}
use Bound::{Between, Items, Number as Range, Text, Time};

/// Type, field and bounds.
type Bounded = (&'static str, &'static str, Vec<Bound>);

fn plus_minus(largest: f64) -> Bound {
    Range(-largest, largest)
}

fn range(of: &RangeInclusive<f64>) -> Bound {
    Range(*of.start(), *of.end())
}

macro_rules! table {
    ($($name:ident.$field:ident: $($bound:expr),+;)*) => {
        vec![$((stringify!($name), stringify!($field), vec![$($bound),+])),*]
    };
}

fn bounded() -> Vec<Bounded> {
    let joints = || Items(1, MAX_LINKS);
    let joint_value = || plus_minus(MAX_JOINT_VALUE_DEG);
    let quaternion_part = || plus_minus(1.0 + MAX_QUATERNION_OFF);
    let rotation_part = || plus_minus(1.0 + ROTATION_TOLERANCE);
    let length = || plus_minus(MAX_LENGTH_MM);
    let fixture = || plus_minus(MAX_FIXTURE_MM);
    let std = || Range(MIN_STD_MM, MAX_STD_MM);
    let id = || Text(1, MAX_ID);
    let label = || Text(1, MAX_LABEL_LENGTH);
    let parameter = || Text(1, MAX_PARAMETER_NAME);
    table! {
        LinkBody.joint_limits_deg: Items(2, 2), plus_minus(MAX_JOINT_DEG);
        GravityDirection.gravity_in_base: Items(3, 3), plus_minus(1.0 + GRAVITY_TOLERANCE);
        RobotPatchBody.joint_limits_deg: joints(), Items(2, 2), plus_minus(MAX_JOINT_DEG);
        JointMapBody.sign: joints(), plus_minus(1.0);
        JointMapBody.offset_deg: joints(), plus_minus(MAX_ANGLE_DEG);
        JointMapBody.coupling: joints(), joints(), plus_minus(MAX_COUPLING);
        PointBody.q_deg: joints(), joint_value();
        PointBody.position_mm: Items(3, 3), plus_minus(MAX_COORDINATE_MM);
        PointBody.quaternion: Items(4, 4), quaternion_part();
        PointBody.configuration: label();
        PointBody.target_name: label();
        PointBody.station: label();
        PointBody.session: label();
        PointBody.measured_at: Time;
        PointBody.std_mm: std();
        PointBody.std_axes_mm: Items(3, 3), std();
        PointBody.covariance_mm2: Items(3, 3), Items(3, 3), plus_minus(MAX_STD_MM * MAX_STD_MM);
        PointBody.temperature_c: plus_minus(MAX_TEMPERATURE_C);
        JobRequestBody.measurement_set_id: id();
        JobRequestBody.measurement_set_ids: Items(2, MAX_SESSIONS), id();
        JobRequestBody.parameter_set_id: id();
        JobRequestBody.frames_id: id();
        JobRequestBody.network_id: id();
        JobRequestBody.residual_network_id: id();
        VerifyBody.fraction: Between(0.0, 1.0);
        VerifyBody.measurement_set_id: id();
        ParametersBody.hold: Items(0, MAX_NAMES), parameter();
        ParametersBody.identify: Items(0, MAX_NAMES), parameter();
        ParametersBody.priors: Items(0, MAX_NAMES);
        Prior.name: parameter();
        Prior.std: Range(MIN_STD, MAX_VALUE);
        Prior.mean: plus_minus(MAX_VALUE);
        Prior.min: plus_minus(MAX_VALUE);
        Prior.max: plus_minus(MAX_VALUE);
        OptionsBody.stop_at_cost_mm2: Range(0.0, MAX_COST_MM2);
        PayloadBody.centre_mm: Items(3, 3), plus_minus(MAX_PAYLOAD_OFFSET_MM);
        PosePlanBody.target_mm: Items(3, 3), length();
        PosePlanBody.instrument_mm: Items(3, 3), length();
        SetUpBody.instrument_mm: Items(3, 3), length();
        PosePlanBody.target_axis: Items(3, 3), plus_minus(1.0);
        PosePlanBody.target_half_angle_deg: range(&HALF_ANGLE_DEG);
        PosePlanBody.noise_std_rotation_deg: range(&NOISE_ROTATION_DEG);
        PosePlanBody.noise_std_mm: range(&NOISE_MM);
        PosePlanBody.n_repeats: Range(0.0, (MAX_PLANNED / 2) as f64);
        PosePlanBody.floor_z_mm: length();
        PosePlanBody.measured: Items(0, MAX_MEASURED), id();
        BoxBody.min_mm: Items(3, 3), length();
        BoxBody.max_mm: Items(3, 3), length();
        BaseCylinderBody.radius_mm: length();
        BaseCylinderBody.height_mm: length();
        PredictBody.q_deg: Items(0, MAX_POSES), joints(), joint_value();
        PredictBody.segment: Range(0.0, f64::from(u32::MAX));
        CompensateBody.q_deg: Items(0, MAX_TARGETS_PER_REQUEST), joints(), joint_value();
        PostureBody.q_deg: joints(), joint_value();
        PostureBody.shown_position_mm: Items(3, 3), plus_minus(MAX_POSITION_MM);
        ShownOrientation.kuka_abc_deg: Items(3, 3), plus_minus(MAX_ANGLE_DEG);
        ShownOrientation.fanuc_wpr_deg: Items(3, 3), plus_minus(MAX_ANGLE_DEG);
        ShownOrientation.ur_rotation_vector_rad: Items(3, 3), plus_minus(MAX_ANGLE_DEG.to_radians());
        ShownOrientation.quaternion: Items(4, 4), quaternion_part();
        ToolBody.translation_mm: Items(3, 3), length();
        ToolBody.quaternion: Items(4, 4), quaternion_part();
        ToolBody.rotation: Items(3, 3), Items(3, 3), rotation_part();
        CartesianTarget.position_mm: Items(3, 3), plus_minus(MAX_TARGET_MM);
        CartesianTarget.quaternion: Items(4, 4), quaternion_part();
        CartesianTarget.rotation: Items(3, 3), Items(3, 3), rotation_part();
        CartesianTarget.q_near_deg: joints(), joint_value();
        WorkFrameBody.measurement_set_id: id();
        WorkFrameBody.translation_mm: Items(3, 3), fixture();
        WorkFrameBody.quaternion: Items(4, 4), quaternion_part();
        WorkFrameBody.rotation: Items(3, 3), Items(3, 3), rotation_part();
        WorkFrameBody.std_mm: Range(0.0, MAX_LENGTH_MM);
        FixturePointBody.nominal_mm: Items(3, 3), fixture();
        FixturePointBody.measured_mm: Items(3, 3), fixture();
    }
}

/// Writes the bounds into a document. Returns the fields that are missing in the document; there should be none.
pub fn write(document: &mut OpenApi) -> Vec<String> {
    let Some(components) = &mut document.components else {
        return Vec::new();
    };
    let mut absent = Vec::new();
    for (name, field, bounds) in bounded() {
        let schema = components.schemas.get_mut(name);
        let found = schema.and_then(|schema| field_of(schema, field));
        if !found.is_some_and(|found| bound(found, &bounds)) {
            absent.push(format!("{name}.{field}"));
        }
    }
    absent
}

/// Finds a field of a type, or of one of its variants.
fn field_of<'s>(schema: &'s mut RefOr<Schema>, field: &str) -> Option<&'s mut RefOr<Schema>> {
    match schema {
        RefOr::T(Schema::Object(object)) => object.properties.get_mut(field),
        RefOr::T(Schema::OneOf(one_of)) => one_of
            .items
            .iter_mut()
            .find_map(|variant| field_of(variant, field)),
        _ => None,
    }
}

/// Writes bounds into a schema. Returns false if the bounds do not match the type of the schema.
fn bound(schema: &mut RefOr<Schema>, bounds: &[Bound]) -> bool {
    let Some((first, rest)) = bounds.split_first() else {
        return true;
    };
    match (schema, first) {
        (RefOr::T(Schema::Array(array)), Items(fewest, most)) => {
            array.min_items = Some(*fewest).filter(|fewest| *fewest > 0);
            array.max_items = Some(*most);
            match &mut array.items {
                ArrayItems::RefOrSchema(items) => bound(items, rest),
                ArrayItems::False => false,
            }
        }
        (RefOr::T(Schema::Object(object)), scalar) => {
            bound_scalar(object, scalar);
            rest.is_empty()
        }
        _ => false,
    }
}

fn bound_scalar(object: &mut Object, bound: &Bound) {
    match bound {
        Range(smallest, largest) => {
            object.minimum = Some(number(*smallest));
            object.maximum = Some(number(*largest));
        }
        Between(low, high) => {
            object.exclusive_minimum = Some(number(*low));
            object.exclusive_maximum = Some(number(*high));
        }
        Text(fewest, most) => {
            object.min_length = Some(*fewest);
            object.max_length = Some(*most);
        }
        Time => {
            object.format = Some(SchemaFormat::KnownFormat(KnownFormat::DateTime));
            object.min_length = Some("2026-03-01T08:15:30Z".len());
            object.max_length = Some(MAX_LABEL_LENGTH);
        }
        Items(..) => {}
    }
}

/// A JSON number, without a decimal point if it is an integer.
fn number(value: f64) -> Number {
    if value.fract() == 0.0 && value.abs() < 1e15 {
        Number::Int(value as isize)
    } else {
        Number::Float(value)
    }
}
