//! What the names mean that programs give to the columns of a point cloud: one table for all formats.

use super::name::Name;

/// What a column tells of a point.
///
/// A role is about meaning, not about type or unit: `Red` is a colour's red part, from 0 to 1, 255 or 65,535.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[non_exhaustive]
pub enum Role {
    /// The first coordinate: x, easting or longitude.
    X,
    /// The second coordinate: y, northing or latitude.
    Y,
    /// The third coordinate: z, elevation, height or altitude.
    Z,
    /// A colour's red part.
    Red,
    /// A colour's green part.
    Green,
    /// A colour's blue part.
    Blue,
    /// A colour's opacity.
    Alpha,
    /// Near infrared, as a fourth colour.
    NearInfrared,
    /// Brightness without a colour.
    Grey,
    /// The first part of a normal.
    NormalX,
    /// The second part of a normal.
    NormalY,
    /// The third part of a normal.
    NormalZ,
    /// The strength of what came back, in the scanner's own measure.
    Intensity,
    /// The share that a surface sends back: `reflectance`, `reflectivity`.
    Reflectance,
    /// The height of an echo, in decibels mostly.
    Amplitude,
    /// Light of the surroundings, as Ouster's sensors measure it.
    Ambient,
    /// The distance to the sensor.
    Range,
    /// What a point belongs to, as LAS numbers it.
    Classification,
    /// What a point belongs to, as others number it: labels, segments, clusters, instances.
    Label,
    /// Which echo of its pulse a point is, from 1.
    ReturnNumber,
    /// How many echoes the pulse has.
    NumberOfReturns,
    /// When the point was measured.
    Time,
    /// The point's own number.
    Id,
    /// Which laser of the scanner measured it.
    Ring,
    /// Which flight line or file it comes from, as LAS numbers it.
    PointSource,
    /// LAS's byte for users.
    UserData,
    /// The angle of the scanner's mirror, in degrees.
    ScanAngle,
    /// An angle that goes round, so that 359 degrees lie beside 1: azimuth, heading, roll.
    Azimuth,
    /// Which way the scanner's mirror went.
    ScanDirection,
    /// Whether it is the last point before the mirror turned.
    EdgeOfFlightLine,
    /// Whether it was not measured.
    Synthetic,
    /// Whether it is a key point of a model.
    KeyPoint,
    /// Whether it should not be used.
    Withheld,
    /// Whether it lies where flight lines overlap.
    Overlap,
    /// Which head of the scanner measured it.
    ScannerChannel,
    /// Which scan or cloud it comes from.
    Scan,
    /// Its row in the scan's raster.
    Row,
    /// Its column in the scan's raster.
    Column,
    /// How sure the position is.
    Confidence,
    /// How far the position may be off, such as COLMAP's mean distance to its sightings, in pixels.
    Error,
    /// Whether the colour is absent.
    ColourInvalid,
    /// Whether the intensity is absent.
    IntensityInvalid,
    /// Whether the time is absent.
    TimeInvalid,
    /// The real part of a rotation, a quaternion.
    RotationW,
    /// The first imaginary part of a rotation.
    RotationX,
    /// The second imaginary part of a rotation.
    RotationY,
    /// The third imaginary part of a rotation.
    RotationZ,
    /// The natural logarithm of a Gaussian's first half axis.
    LogScaleX,
    /// The natural logarithm of a Gaussian's second half axis.
    LogScaleY,
    /// The natural logarithm of a Gaussian's third half axis.
    LogScaleZ,
    /// The logit of a Gaussian's opacity.
    Opacity,
    /// The red part of a Gaussian's colour that is the same from all sides.
    HarmonicRed,
    /// The green part of that colour.
    HarmonicGreen,
    /// The blue part of that colour.
    HarmonicBlue,
    /// A coefficient of how that colour depends on the side; these are numbered.
    Harmonic,
}

/// A role, the name that this program gives to it, and the others that it is known by: in lower case, without
/// whatever is neither letter nor digit.
type Row = (Role, &'static str, &'static [&'static str]);

/// The one table. Names that mean something in company alone are in [`COMPANIES`] and in `axes.rs`.
#[rustfmt::skip]
const TABLE: &[Row] = &[
    (Role::X, "x", &[
        "easting", "eastings", "east", "utmeasting", "rechtswert", "ostwert", "longitude", "lon", "lng", "xcoord",
        "coordx", "xcoordinate", "coordinatex", "xkoordinate", "posx", "positionx", "points0", "pointsx", "pointsmxyz0", "cartesianx",
    ]),
    (Role::Y, "y", &[
        "northing", "northings", "north", "utmnorthing", "hochwert", "nordwert", "latitude", "lat", "ycoord",
        "coordy", "ycoordinate", "coordinatey", "ykoordinate", "posy", "positiony", "points1", "pointsy", "pointsmxyz1", "cartesiany",
    ]),
    (Role::Z, "z", &[
        "elevation", "elev", "height", "altitude", "alt", "höhe", "hoehe", "zcoord", "coordz", "zcoordinate",
        "coordinatez", "zkoordinate", "posz", "positionz", "points2", "pointsz", "pointsmxyz2", "cartesianz", "ellipsoidalheight",
        "orthometricheight",
    ]),
    (Role::Red, "red", &["diffusered", "colorred", "colourred", "colorr", "rgb0", "rgba0", "rgbr", "colors0", "color0", "colorsr", "rgbred"]),
    (Role::Green, "green", &["diffusegreen", "colorgreen", "colourgreen", "colorg", "rgb1", "rgba1", "rgbg", "colors1", "color1", "colorsg", "rgbgreen"]),
    (Role::Blue, "blue", &["diffuseblue", "colorblue", "colourblue", "colorb", "rgb2", "rgba2", "rgbb", "colors2", "color2", "colorsb", "rgbblue"]),
    (Role::Alpha, "alpha", &["diffusealpha", "coloralpha", "colouralpha", "colora", "rgba3", "rgbaa"]),
    (Role::NearInfrared, "nir", &["infrared", "nearinfrared", "nearir"]),
    (Role::Grey, "grey", &["gray", "greyscale", "grayscale", "luminance", "greyvalue", "grayvalue"]),
    (Role::NormalX, "nx", &["normalx", "normalsx", "normal0", "normals0", "norx", "xnormal", "pointnormalx"]),
    (Role::NormalY, "ny", &["normaly", "normalsy", "normal1", "normals1", "nory", "ynormal", "pointnormaly"]),
    (Role::NormalZ, "nz", &["normalz", "normalsz", "normal2", "normals2", "norz", "znormal", "pointnormalz"]),
    (Role::Intensity, "intensity", &["intensities", "intens", "remission", "lidarintensity", "returnintensity", "signal", "signalphotons"]),
    (Role::Reflectance, "reflectance", &["reflectivity", "reflectances", "reflection", "reflectionvalue"]),
    (Role::Amplitude, "amplitude", &["amplitudes"]),
    (Role::Ambient, "ambient", &["ambientlight"]),
    (Role::Range, "range", &["distance", "ranges"]),
    (Role::Classification, "classification", &["class", "classid", "classes", "rawclassification", "lasclassification", "classificationid", "classcode"]),
    (Role::Label, "label", &[
        "labels", "sem", "semantics", "semantic", "semanticlabel", "semanticid", "semlabel", "segment", "segmentid", "segmentation", "cluster",
        "clusterid", "instance", "instanceid", "instancelabel", "category", "labelid", "objectid", "treeid",
    ]),
    (Role::ReturnNumber, "return_number", &[
        "returnnum", "returnno", "return", "returnid", "returnindex", "numberofreturn", "echonumber", "echoindex",
        "echoid", "echo", "numecho",
    ]),
    (Role::NumberOfReturns, "number_of_returns", &[
        "numreturns", "numberreturns", "returncount", "nrofreturns", "noofreturns", "nreturns", "returns",
        "totalreturns", "returnsofpulse", "numberofreturnsofgivenpulse", "numofreturns", "nrofechos", "nrofechoes",
        "numberofechoes", "echocount", "nbofecho",
    ]),
    (Role::Time, "gps_time", &[
        "time", "gps", "timestamp", "timestamps", "times", "adjustedtime", "adjustedgpstime", "offsettime",
        "timeoffset", "gpstimestamp", "internaltime", "pointtime", "acquisitiontime", "timeofday", "utctime",
    ]),
    (Role::Id, "id", &[
        "ids", "pointid", "pointids", "pointindex", "index", "ptid", "pointnumber", "pointno", "pointnr", "point3did",
        "originalindex", "originalid", "originalpointids", "originalpointid", "uid", "vertexid", "vertexindex",
        "sourceindex", "fid", "oid", "objectnumber",
    ]),
    (Role::Ring, "ring", &["laserid", "laser", "laserring", "laserchannel", "lasernumber", "beam", "beamid", "ringid", "ringnumber", "ringindex", "channel", "line"]),
    (Role::PointSource, "point_source_id", &["pointsource", "sourceid", "ptsrcid", "ptsourceid", "pointsourceids", "flightline", "flightlineid", "flightlinenumber", "fileid", "filesourceid"]),
    (Role::UserData, "user_data", &["userdatum"]),
    (Role::ScanAngle, "scan_angle", &["scananglerank", "scanangledegrees"]),
    (Role::Azimuth, "azimuth", &["heading", "yaw", "azimuthangle", "bearing", "horizontalangle", "hue", "dipdirection", "dipdir", "phi", "roll", "pitch", "omega", "kappa"]),
    (Role::ScanDirection, "scan_direction_flag", &["scandirection", "scandir"]),
    (Role::EdgeOfFlightLine, "edge_of_flight_line", &["edgeofflightlineflag", "edgeofflight", "flightlineedge", "edgeflightline"]),
    (Role::Synthetic, "synthetic", &["syntheticflag", "synthetics"]),
    (Role::KeyPoint, "key_point", &["keypointflag", "modelkeypoint"]),
    (Role::Withheld, "withheld", &["withheldflag"]),
    (Role::Overlap, "overlap", &["overlapflag"]),
    (Role::ScannerChannel, "scanner_channel", &["scanchannel"]),
    (Role::Scan, "scan", &["scanid", "scanindex", "scannumber", "originalcloudindex", "cloudindex", "cloudid", "frame", "frameid", "frameindex", "stationid", "setupid"]),
    (Role::Row, "row_index", &["row"]),
    (Role::Column, "column_index", &["column", "col", "colindex"]),
    (Role::Confidence, "confidence", &["conf", "certainty"]),
    (Role::Error, "error", &["reprojectionerror", "reprojerror", "meanreprojectionerror", "meanreprojerror"]),
    (Role::ColourInvalid, "color_invalid", &["iscolorinvalid", "colourinvalid", "iscolourinvalid"]),
    (Role::IntensityInvalid, "intensity_invalid", &["isintensityinvalid"]),
    (Role::TimeInvalid, "timestamp_invalid", &["istimestampinvalid", "timeinvalid"]),
    (Role::RotationW, "rot_0", &["rotation0", "quat0", "quaternion0", "q0", "rotationw", "rotw", "qw", "quatw", "quaternionw", "orientationw"]),
    (Role::RotationX, "rot_1", &["rotation1", "quat1", "quaternion1", "q1", "rotationx", "rotx", "qx", "quatx", "quaternionx", "orientationx"]),
    (Role::RotationY, "rot_2", &["rotation2", "quat2", "quaternion2", "q2", "rotationy", "roty", "qy", "quaty", "quaterniony", "orientationy"]),
    (Role::RotationZ, "rot_3", &["rotation3", "quat3", "quaternion3", "q3", "rotationz", "rotz", "qz", "quatz", "quaternionz", "orientationz"]),
    (Role::LogScaleX, "scale_0", &[]),
    (Role::LogScaleY, "scale_1", &[]),
    (Role::LogScaleZ, "scale_2", &[]),
    (Role::Opacity, "opacity", &[]),
    (Role::HarmonicRed, "f_dc_0", &[]),
    (Role::HarmonicGreen, "f_dc_1", &[]),
    (Role::HarmonicBlue, "f_dc_2", &[]),
    (Role::Harmonic, "f_rest", &[]),
];

/// Short names that mean something only where all of them are there.
const COMPANIES: &[[(&str, Role); 3]] = &[
    [("r", Role::Red), ("g", Role::Green), ("b", Role::Blue)],
    [("rf", Role::Red), ("gf", Role::Green), ("bf", Role::Blue)],
];

/// Names that mean something only beside a column of one of these roles.
const GUESTS: &[(&str, Role, &[Role])] = &[
    ("a", Role::Alpha, &[Role::Red]),
    ("af", Role::Alpha, &[Role::Red]),
    ("ir", Role::NearInfrared, &[Role::Red]),
    ("t", Role::Time, &[Role::Ring, Role::Reflectance, Role::Ambient]),
];

impl Role {
    /// What a name means on its own, in any case and with any separators, and whatever units or prefixes a program puts
    /// about it: `GpsTime`, `gps-time`, `scalar_Gps_Time` and `GPS time [s]` are one. Names of a letter or two say nothing
    /// alone, but for those of coordinates and normals: see [`roles_of`].
    #[must_use]
    pub fn of(name: &str) -> Option<Self> {
        Name::of(name).keys().find_map(Self::of_key)
    }

    /// What this program calls it, and LAS's fields, too, where there is one. Of [`Role::Harmonic`], whose columns are
    /// numbered (`f_rest_0`), the beginning.
    #[must_use]
    pub fn name(self) -> &'static str {
        TABLE.iter().find(|(role, ..)| *role == self).map_or("", |(_, name, _)| name)
    }

    /// All roles, in the order of the table in `docs/attributes.md`.
    pub fn all() -> impl Iterator<Item = Self> {
        TABLE.iter().map(|(role, ..)| *role)
    }

    /// Other names that it is known by: in lower case, without separators, units and prefixes.
    #[must_use]
    pub fn others(self) -> &'static [&'static str] {
        TABLE.iter().find(|(role, ..)| *role == self).map_or(&[], |(.., others)| others)
    }

    fn of_key(key: &str) -> Option<Self> {
        let numbered = |rest: &str| !rest.is_empty() && rest.bytes().all(|b| b.is_ascii_digit());
        if key.strip_prefix("frest").is_some_and(numbered) {
            return Some(Self::Harmonic);
        }
        let known = |row: &&Row| is_spelt(row.1, key) || row.2.contains(&key);
        let role = TABLE.iter().find(known).map(|(role, ..)| *role);
        role.filter(|role| *role != Self::Harmonic)
    }
}

/// Whether a name is this key, its separators aside.
fn is_spelt(name: &str, key: &str) -> bool {
    name.bytes().filter(|b| *b != b'_').eq(key.bytes())
}

/// What each of a cloud's columns means, by its own name and those of the others: `r`, `g` and `b` are a colour where all
/// three are there; a single `r` is none. Two columns may have one role; see [`column_of`].
#[must_use]
pub fn roles_of<S: AsRef<str>>(names: &[S]) -> Vec<Option<Role>> {
    let names: Vec<Name> = names.iter().map(|name| Name::of(name.as_ref())).collect();
    let mut roles: Vec<Option<Role>> = names.iter().map(|name| name.keys().find_map(Role::of_key)).collect();
    for company in COMPANIES {
        let places = company.map(|(short, _)| names.iter().position(|name| name.is(short)));
        let [Some(first), Some(second), Some(third)] = places else { continue };
        for (place, (_, role)) in [first, second, third].into_iter().zip(company) {
            roles[place] = Some(*role);
        }
    }
    for (short, role, hosts) in GUESTS {
        let Some(place) = names.iter().position(|name| name.is(short)) else { continue };
        if roles.iter().flatten().any(|role| hosts.contains(role)) {
            roles[place].get_or_insert(*role);
        }
    }
    roles
}

/// The column that has a role: of several the one that this program would name so, else the first.
#[must_use]
pub fn column_of<S: AsRef<str>>(names: &[S], role: Role) -> Option<usize> {
    let roles = roles_of(names);
    let mut places = (0..names.len()).filter(|i| roles[*i] == Some(role));
    places.clone().find(|i| names[*i].as_ref() == role.name()).or_else(|| places.next())
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    use super::*;

    /// Names as programs write them, and what they mean.
    const KNOWN: &[(Role, &[&str])] = &[
        (
            Role::X,
            &[
                "x",
                "X",
                "//X",
                "# x",
                "X [m]",
                "X(m)",
                "x_coord",
                "x_m",
                "Easting",
                "Points:0",
                "Points_m_XYZ:0",
            ],
        ),
        (Role::Y, &["y", "\"Y\"", "Northing (US-ft)", "LATITUDE", "Points:1", "coord. y", "vertex.y"]),
        (Role::Z, &["Z", "Elevation", "height_m", "Höhe", "HÖHE", "alt", "properties.z"]),
        (
            Role::Red,
            &["red", "Red", "RED", "diffuse_red", "RGB:0", "Colors_0", "color.red", "rgb (0)", "rgb[0]"],
        ),
        (Role::Blue, &["blue", "Blue", "RGB:2", "diffuse-blue"]),
        (Role::Alpha, &["alpha", "Alpha", "diffuse_alpha", "RGBA:3"]),
        (Role::NearInfrared, &["nir", "Infrared", "near_ir", "NearInfrared"]),
        (
            Role::NormalX,
            &["nx", "Nx", "normal_x", "NormalX", "Normals:0", "scalar_Nx", "normals[0]", "Normals (x)"],
        ),
        (Role::NormalZ, &["nz", "NORMAL_Z", "normal.z", "Normals:2"]),
        (
            Role::Intensity,
            &["intensity", "Intensity", "scalar_Intensity", "Scalar field Intensity", "intensity_"],
        ),
        (Role::Intensity, &["scalar_scalar_Intensity", "Intensity (raw)", "remission", "points.intensity"]),
        (Role::Reflectance, &["reflectivity", "Reflectance [dB]", "scalar_Reflectance"]),
        (Role::Range, &["range", "distance_m"]),
        (Role::Classification, &["Classification", "class", "scalar_Classification", "raw_classification"]),
        (Role::Label, &["label", "Label", "scalar_label", "instance", "segment_id"]),
        (Role::ReturnNumber, &["ReturnNumber", "return_number", "Return Number", "scalar_ReturnNumber"]),
        (Role::NumberOfReturns, &["NumberOfReturns", "number_of_returns", "num_returns", "NrOfEchos"]),
        (
            Role::Time,
            &["GpsTime", "gps_time", "GPS Time", "Gps_Time", "adjustedtime", "timestamp", "time", "Time (s)"],
        ),
        (Role::Time, &["offset_time", "timestamp_ns", "scalar_GpsTime"]),
        (Role::Id, &["PointID", "id", "POINT3D_ID", "point_id", "scalar_id", "Index"]),
        (Role::Ring, &["ring", "laser_id", "Ring", "beam", "scalar_ring"]),
        (Role::PointSource, &["PointSourceId", "point_source_id", "Point Source ID", "scalar_PointSourceId"]),
        (Role::UserData, &["UserData", "user_data", "scalar_UserData"]),
        (
            Role::ScanAngle,
            &["ScanAngleRank", "scan_angle_rank", "scan_angle", "Scan Angle", "scan angle [deg]"],
        ),
        (Role::Azimuth, &["azimuth", "Azimuth (deg)", "heading"]),
        (Role::ScanDirection, &["ScanDirectionFlag", "scan_direction_flag"]),
        (Role::EdgeOfFlightLine, &["EdgeOfFlightLine", "edge_of_flight_line"]),
        (Role::ScannerChannel, &["ScanChannel", "scanner_channel"]),
        (Role::Scan, &["scan", "scalar_Original_cloud_index", "scan_id"]),
        (Role::Row, &["row", "row_index", "rowIndex"]),
        (Role::Column, &["column", "column_index", "columnIndex"]),
        (Role::Confidence, &["confidence", "Confidence"]),
        (Role::Error, &["error", "ERROR", "scalar_error", "reprojection_error"]),
        (Role::ColourInvalid, &["color_invalid", "isColorInvalid"]),
        (Role::IntensityInvalid, &["intensity_invalid", "isIntensityInvalid"]),
        (Role::RotationW, &["rot_0", "qw", "quat_w", "rotation.w"]),
        (Role::RotationZ, &["rot_3", "qz"]),
        (Role::LogScaleY, &["scale_1"]),
        (Role::Opacity, &["opacity"]),
        (Role::HarmonicGreen, &["f_dc_1"]),
        (Role::Harmonic, &["f_rest_0", "f_rest_44"]),
    ];

    #[test]
    fn names_are_known_however_programs_write_them() {
        for (role, names) in KNOWN {
            for name in *names {
                assert_eq!(Role::of(name), Some(*role), "{name}");
            }
        }
    }

    #[test]
    fn what_says_nothing_has_no_role() {
        for name in [
            "",
            "_",
            "()",
            "[m]",
            "r",
            "g",
            "b",
            "a",
            "t",
            "e",
            "n",
            "h",
            "i",
            "ir",
            "rf",
            "quality",
            "curvature",
            "radius",
            "Illuminance (PCV)",
            "f_rest",
            "f_rest_x",
            "scalar",
            "scalar field",
            "column 4",
            "Column4",
            "intensity_2",
            "redness",
            "xy",
            "temperature",
            "unknown",
            "numberless",
            "x2",
            "nxx",
            "depth",
            "😀",
        ] {
            assert_eq!(Role::of(name), None, "{name}");
        }
    }

    #[test]
    fn every_role_has_one_row_and_every_name_one_role() {
        let mut seen = HashMap::new();
        for (role, name, others) in TABLE {
            assert_eq!(role.name(), *name);
            if *role != Role::Harmonic {
                assert_eq!(Role::of(name), Some(*role), "{name}");
            }
            let own: String = name.chars().filter(|c| *c != '_').collect();
            for key in [own.as_str()].iter().chain(*others) {
                assert!(key.chars().all(|c| c.is_alphanumeric() && !c.is_uppercase()), "{key}");
                assert_eq!(seen.insert((*key).to_owned(), *role), None, "{key} twice");
                assert!(*role == Role::Harmonic || Role::of(key) == Some(*role), "{key}");
            }
        }
    }

    #[test]
    fn short_names_mean_something_in_company_alone() {
        let roles = |names: &[&str]| roles_of(names);
        let rgb = [Some(Role::Red), Some(Role::Green), Some(Role::Blue)];
        assert_eq!(roles(&["r", "g", "b"]), rgb);
        assert_eq!(roles(&["R", "G", "B"]), rgb);
        assert_eq!(roles(&["Rf", "Gf", "Bf"]), rgb);
        assert_eq!(roles(&["scalar_R", "scalar_G", "scalar_B"]), rgb);
        assert_eq!(roles(&["b", "r", "g"]), [Some(Role::Blue), Some(Role::Red), Some(Role::Green)]);
        assert_eq!(roles(&["r", "g"]), [None, None]);
        assert_eq!(roles(&["r", "n", "a"]), [None; 3]);
        assert_eq!(roles(&["a", "r", "g", "b", "ir"])[0], Some(Role::Alpha));
        assert_eq!(roles(&["a", "r", "g", "b", "ir"])[4], Some(Role::NearInfrared));
        assert_eq!(roles(&["t", "ring"]), [Some(Role::Time), Some(Role::Ring)]);
        assert_eq!(roles(&["s", "t"]), [None, None]);
        let none: [&str; 0] = [];
        assert!(roles_of(&none).is_empty());
    }

    #[test]
    fn of_two_columns_of_a_role_the_one_of_this_programs_name_comes_first() {
        let find = |names: &[&str]| column_of(names, Role::Intensity);
        assert_eq!(find(&["scalar_Intensity", "intensity"]), Some(1));
        assert_eq!(find(&["a", "Intensity", "scalar_Intensity"]), Some(1));
        assert_eq!(find(&["a", "b"]), None);
    }
}
