//! Which columns of a table are the coordinates, by their names.

use super::name::Name;

/// Where the coordinates of points stand in a table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Axes {
    /// The columns of x, y and z.
    pub columns: [usize; 3],
    /// Whether x and y are longitude and latitude: degrees, most likely, beside heights in metres.
    pub geographic: bool,
}

/// Several columns may be the same coordinate.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{} may all be the coordinate {axis}", names.join(", "))]
#[non_exhaustive]
pub struct AmbiguousAxes {
    /// `x`, `y` or `z`.
    pub axis: char,
    /// The names of the columns, as they stand in the file.
    pub names: Vec<String>,
}

/// Names that go together. A table has a family where it has a name of each axis.
struct Family {
    axes: [&'static [&'static str]; 3],
    geographic: bool,
}

const fn family(axes: [&'static [&'static str]; 3]) -> Family {
    Family { axes, geographic: false }
}

/// Heights, in families that call them many ways.
const HEIGHTS: &[&str] = &[
    "elevation",
    "elev",
    "height",
    "altitude",
    "alt",
    "z",
    "h",
    "höhe",
    "hoehe",
    "up",
    "level",
    "rl",
    "ellipsoidalheight",
    "orthometricheight",
];

/// In order: the first of them that a table has is taken. ParaView's `Points:*` stand before `X`, `Y` and `Z`, since they
/// are where the points are, and further columns are any data; a projection stands before longitude and latitude.
const FAMILIES: &[&[Family]] = &[
    &[
        family([&["points0", "pointsx"], &["points1", "pointsy"], &["points2", "pointsz"]]),
        family([&["pointsmxyz0"], &["pointsmxyz1"], &["pointsmxyz2"]]),
    ],
    &[family([&["x"], &["y"], &["z"]])],
    &[
        family([&["xcoord", "coordx"], &["ycoord", "coordy"], &["zcoord", "coordz"]]),
        family([
            &["xcoordinate", "coordinatex", "xkoordinate"],
            &["ycoordinate", "coordinatey", "ykoordinate"],
            &["zcoordinate", "coordinatez", "zkoordinate"],
        ]),
        family([&["posx", "positionx"], &["posy", "positiony"], &["posz", "positionz"]]),
        family([
            &["pos0", "position0", "positions0"],
            &["pos1", "position1", "positions1"],
            &["pos2", "position2", "positions2"],
        ]),
        family([&["xyz0", "xyzx"], &["xyz1", "xyzy"], &["xyz2", "xyzz"]]),
        family([
            &["coords0", "coord0", "coordinates0"],
            &["coords1", "coord1", "coordinates1"],
            &["coords2", "coord2", "coordinates2"],
        ]),
        family([&["cartesianx"], &["cartesiany"], &["cartesianz"]]),
        family([&["px"], &["py"], &["pz"]]),
        family([&["pointx"], &["pointy"], &["pointz"]]),
        family([&["xecef", "ecefx"], &["yecef", "ecefy"], &["zecef", "ecefz"]]),
        family([&["xutm", "utmx"], &["yutm", "utmy"], &["zutm", "utmz", "z"]]),
    ],
    &[family([&["x"], &["y"], &["elevation", "elev", "height", "altitude", "alt", "höhe", "hoehe"]])],
    &[
        family([
            &["easting", "eastings", "east", "utmeasting", "utme", "rechtswert", "ostwert"],
            &["northing", "northings", "north", "utmnorthing", "utmn", "hochwert", "nordwert"],
            HEIGHTS,
        ]),
        family([&["e"], &["n"], HEIGHTS]),
    ],
    &[Family {
        axes: [&["longitude", "lon", "long", "lng"], &["latitude", "lat"], HEIGHTS],
        geographic: true,
    }],
];

/// Finds the three columns that are the coordinates, by their names, in any case and any order. They are of one family:
/// `x, y, z`, `Points:0, Points:1, Points:2`, `x_coord` and so on, easting, northing and a height, longitude, latitude
/// and a height; `x` and `northing` are none. None where no family is whole. Names without what programs put before
/// them (`field_x`) count only where no other names are a family; in a unit of time, or of an angle but for longitude
/// and latitude, none does.
///
/// # Errors
/// [`AmbiguousAxes`] where two columns are the same coordinate (`x` and `X`), or two families are whole that are as good.
pub fn axes_of<S: AsRef<str>>(names: &[S]) -> Result<Option<Axes>, AmbiguousAxes> {
    let keys: Vec<Name> = names.iter().map(|name| Name::of(name.as_ref())).collect();
    for shortened in [false, true] {
        for rank in FAMILIES {
            if let Some((axes, geographic)) = rank_of(rank, &keys, shortened) {
                let columns = one_of_each(&axes, names)?;
                return Ok(Some(Axes { columns, geographic }));
            }
        }
    }
    Ok(None)
}

/// The columns that may be x, y and z by the whole families of a rank, if there is one; and whether the first is
/// geographic.
fn rank_of(rank: &[Family], keys: &[Name], shortened: bool) -> Option<([Vec<usize>; 3], bool)> {
    let places = |family: &Family| {
        family.axes.map(|known| -> Vec<usize> {
            let is_axis =
                |i: &usize| known.iter().any(|key| keys[*i].is_axis(key, family.geographic, shortened));
            (0..keys.len()).filter(is_axis).collect()
        })
    };
    let found = rank.iter().map(|family| (family, places(family)));
    let whole: Vec<_> = found.filter(|(_, axes)| axes.iter().all(|axis| !axis.is_empty())).collect();
    let geographic = whole.first()?.0.geographic;
    let axes = [0, 1, 2].map(|axis| {
        let mut all: Vec<usize> = whole.iter().flat_map(|(_, axes)| axes[axis].iter().copied()).collect();
        all.sort_unstable();
        all.dedup();
        all
    });
    Some((axes, geographic))
}

/// The one column of each axis.
fn one_of_each<S: AsRef<str>>(axes: &[Vec<usize>; 3], names: &[S]) -> Result<[usize; 3], AmbiguousAxes> {
    let mut columns = [0; 3];
    for ((axis, all), column) in ['x', 'y', 'z'].into_iter().zip(axes).zip(&mut columns) {
        if all.len() > 1 {
            let names = all.iter().map(|i| names[*i].as_ref().to_owned()).collect();
            return Err(AmbiguousAxes { axis, names });
        }
        *column = all[0];
    }
    Ok(columns)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn columns(header: &str) -> Result<Option<[usize; 3]>, AmbiguousAxes> {
        let names: Vec<&str> = header.split(',').collect();
        axes_of(&names).map(|axes| axes.map(|axes| axes.columns))
    }

    #[test]
    fn coordinates_are_found_by_the_names_that_programs_write() {
        for (header, wanted) in [
            ("x,y,z", [0, 1, 2]),
            ("X,Y,Z,R,G,B", [0, 1, 2]),
            ("z,id,y,x", [3, 2, 0]),
            ("//X,Y,Z,Intensity", [0, 1, 2]),
            ("x [m],y [m],z [m]", [0, 1, 2]),
            ("X(m),Y(m),Z(m)", [0, 1, 2]),
            ("x_m,y_m,z_m", [0, 1, 2]),
            ("label,x_coord,y_coord,z_coord", [1, 2, 3]),
            ("Coord. X,Coord. Y,Coord. Z", [0, 1, 2]),
            ("pos_x,pos_y,pos_z", [0, 1, 2]),
            ("xyz_0,xyz_1,xyz_2", [0, 1, 2]),
            ("PointID,Easting,Northing,Elevation,Code", [1, 2, 3]),
            ("Point,Northing,Easting,Elevation,Description", [2, 1, 3]),
            ("Rechtswert,Hochwert,Höhe", [0, 1, 2]),
            ("name,E,N,H", [1, 2, 3]),
            ("Easting (X),Northing (Y),Elevation (Z)", [0, 1, 2]),
            ("UTM_X,UTM_Y,Z", [0, 1, 2]),
            ("POINT_X,POINT_Y,POINT_Z", [0, 1, 2]),
            ("X-Koordinate,Y-Koordinate,Z-Koordinate", [0, 1, 2]),
            ("P,N,E,Z,D", [2, 1, 3]),
            ("E [m],N [m],H [m]", [0, 1, 2]),
            ("GPS Latitude,GPS Longitude,GPS Altitude", [1, 0, 2]),
            ("riegl.xyz[0],riegl.xyz[1],riegl.xyz[2]", [0, 1, 2]),
            ("#x,y,alt", [0, 1, 2]),
            ("easting_m,northing_m,height_m", [0, 1, 2]),
            ("lat,lon,alt", [1, 0, 2]),
            ("Longitude,Latitude,Height (m)", [0, 1, 2]),
            ("X,Y,Elevation", [0, 1, 2]),
            ("Temp,Normals:0,Normals:1,Normals:2,Points:0,Points:1,Points:2", [4, 5, 6]),
            ("Points_m_XYZ:0,Points_m_XYZ:1,Points_m_XYZ:2,X,Y,Z,azimuth", [0, 1, 2]),
            ("Points:0,Points:1,Points:2,Points_Magnitude,X,Y,Z", [0, 1, 2]),
            ("POINT3D_ID,X,Y,Z,R,G,B,ERROR", [1, 2, 3]),
            ("x,y,z,height,elevation", [0, 1, 2]),
            ("lon,lat,easting,northing,height", [2, 3, 4]),
            ("x,y,z,easting,northing,elevation", [0, 1, 2]),
            ("x,y,z,Coord. X,Coord. Y,Coord. Z", [0, 1, 2]),
            ("vertex.x,vertex.y,vertex.z", [0, 1, 2]),
            ("e,n,nx,ny,nz,z", [0, 1, 5]),
            ("easting,northing,elevation,field_x,field_y,field_z", [0, 1, 2]),
            ("field_x,field_y,field_z,x,y,z", [3, 4, 5]),
            ("lat,lon,alt,scalar_X,scalar_Y,scalar_Z", [1, 0, 2]),
            ("POINT_X,POINT_Y,POINT_Z,longitude,latitude,elevation", [0, 1, 2]),
            ("x_deg,y_deg,z_deg,E,N,H", [3, 4, 5]),
            ("x [rad],y [rad],z [rad],x_coord,y_coord,z_coord", [3, 4, 5]),
            ("lat_deg,lon_deg,height_m", [1, 0, 2]),
            ("Latitude [deg],Longitude [deg],Height [m]", [1, 0, 2]),
            ("scalar_X,scalar_Y,scalar_Z", [0, 1, 2]),
        ] {
            assert_eq!(columns(header), Ok(Some(wanted)), "{header}");
        }
    }

    #[test]
    fn families_are_not_mixed() {
        for header in [
            "",
            "x,y",
            "x,northing,z",
            "easting,y,z",
            "a,b,c",
            "e,z,h",
            "nx,ny,nz",
            "lon,northing,z",
            "x,y,depth",
            "x_deg,y_deg,z_deg",
            "x_s,y_s,z_s",
        ] {
            assert_eq!(columns(header), Ok(None), "{header}");
        }
    }

    #[test]
    fn what_may_be_two_things_is_told() {
        for (header, axis, names) in [
            ("X,Y,Z,x,y,z", 'x', "X, x"),
            ("x,y,z,Z", 'z', "z, Z"),
            ("easting,northing,elevation,height", 'z', "elevation, height"),
            ("x,y,height,altitude", 'z', "height, altitude"),
            ("e,easting,n,northing,h", 'x', "e, easting"),
            ("pos_x,pos_y,pos_z,x_coord,y_coord,z_coord", 'x', "pos_x, x_coord"),
        ] {
            let why = columns(header).expect_err(header);
            assert_eq!((why.axis, why.names.join(", ").as_str()), (axis, names), "{header}");
        }
        let why = columns("x,X,y,z").expect_err("two").to_string();
        assert_eq!(why, "x, X may all be the coordinate x");
    }

    #[test]
    fn degrees_are_told_from_metres() {
        let geographic = |names: [&str; 3]| axes_of(&names).expect("one").expect("axes").geographic;
        assert!(geographic(["lon", "lat", "alt"]) && !geographic(["e", "n", "h"]));
    }
}
