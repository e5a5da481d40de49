//! What becomes of each attribute, decided once for a whole cloud.

use densecloud_cloud::{Attribute, Facts, Role, roles_of};

use super::rules::{Rule, Rules, usual};

/// What becomes of each attribute of a cloud: which are taken from the nearest point, which are means, and which of them
/// are one quantity.
///
/// It depends on all values of the cloud, so a part of a cloud goes by the plan of the whole. Decided for each attribute:
///
/// 1. A rule that is [set](Rules) by name.
/// 2. What its name means ([`Role`]), in any case and with any prefix: colours, intensities, distances and whatever else
///    varies along a surface are means; classes, labels, times, numbers and flags are from the nearest point, and so is a
///    direction that goes round, such as an azimuth.
/// 3. A word in its name that says it numbers something (`class`, `id`, `time`, `segment`): from the nearest point.
/// 4. Its type: integers are from the nearest point. Floats are, too, where all are whole numbers, and there are at most
///    half as many different ones as there are points; others are means.
///
/// Columns that are one quantity go together: see [`carry()`](super::carry()). So do a column and the flags that tell where
/// it has no value: `color_invalid` for the colour, `NAME_invalid` for the column of that name, with 0 and 1 in it.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Plan {
    pub(super) groups: Vec<Group>,
    /// Of each attribute of the cloud, its rule.
    rules: Vec<Rule>,
    told: Vec<String>,
}

/// Attributes that are computed together.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Group {
    /// Their places in the cloud.
    pub(super) columns: Vec<usize>,
    pub(super) how: How,
    /// Places of the flags that tell where there is no value.
    pub(super) flags: Vec<usize>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum How {
    Mean,
    Nearest,
    /// A vector of three parts with a side.
    Normal,
    /// A quaternion, whose negative is the same rotation.
    Rotation,
    /// Whether there is a value in other columns.
    Flag,
}

/// Roles that are one quantity.
const QUANTITIES: [(How, &[Role]); 4] = [
    (How::Normal, &NORMAL),
    (How::Rotation, &[Role::RotationW, Role::RotationX, Role::RotationY, Role::RotationZ]),
    (How::Mean, &COLOUR),
    (How::Mean, &[Role::LogScaleX, Role::LogScaleY, Role::LogScaleZ]),
];

const NORMAL: [Role; 3] = [Role::NormalX, Role::NormalY, Role::NormalZ];
const COLOUR: [Role; 3] = [Role::Red, Role::Green, Role::Blue];

/// A colour that depends on the side: as many coefficients as there are.
const HARMONICS: [Role; 4] = [Role::HarmonicRed, Role::HarmonicGreen, Role::HarmonicBlue, Role::Harmonic];

impl Plan {
    /// Decides for the attributes of a whole cloud.
    ///
    /// Cost: a pass over those whose numbers decide: floats whose name does not, and flags.
    #[must_use]
    pub fn of(attributes: &[Attribute], set: &Rules) -> Self {
        Self::by_facts(attributes, set, &|i| Facts::of(&attributes[i].values))
    }

    /// As [`of`](Self::of), of attributes whose values are elsewhere: `facts` tells of each, by its place, what they are
    /// like. O(1) an attribute.
    #[must_use]
    pub fn by_facts(attributes: &[Attribute], set: &Rules, facts: &dyn Fn(usize) -> Facts) -> Self {
        Planner::new(attributes, set, facts).plan()
    }

    /// The rule of each attribute, in their order. Those of one quantity have the rule [`Rule::Mean`].
    #[must_use]
    pub fn rules(&self) -> &[Rule] {
        &self.rules
    }

    /// The places of the attributes that the result has, too.
    pub(super) fn kept(&self) -> impl Iterator<Item = usize> {
        (0..self.rules.len()).filter(|i| self.rules[*i] != Rule::Drop)
    }

    /// What a person should know about what was decided, a sentence each.
    #[must_use]
    pub fn warnings(&self) -> &[String] {
        &self.told
    }
}

/// Where the three parts of a normal stand, if all are there and are floats.
pub(super) fn normal_of(attributes: &[Attribute]) -> Option<[usize; 3]> {
    let names: Vec<&str> = attributes.iter().map(|a| a.name.as_str()).collect();
    let roles = roles_of(&names);
    let set = sets(&roles, &NORMAL).into_iter().next()?;
    let floats = set.iter().all(|i| attributes[*i].values.kind().is_float());
    <[usize; 3]>::try_from(set).ok().filter(|_| floats)
}

/// Columns of these roles, one of each, where there are as many of one as of another: `nx`, `ny`, `nz`, `normal_x`,
/// `normal_y` and `normal_z` are two sets.
fn sets(roles: &[Option<Role>], wanted: &[Role]) -> Vec<Vec<usize>> {
    let places = |role: &Role| (0..roles.len()).filter(|i| roles[*i] == Some(*role)).collect::<Vec<_>>();
    let places: Vec<Vec<usize>> = wanted.iter().map(places).collect();
    let count = places.first().map_or(0, Vec::len);
    if places.iter().any(|p| p.len() != count) {
        return Vec::new();
    }
    (0..count).map(|i| places.iter().map(|p| p[i]).collect()).collect()
}

/// A plan in the making.
struct Planner<'a> {
    attributes: &'a [Attribute],
    /// What the numbers of each are like.
    facts: &'a dyn Fn(usize) -> Facts,
    /// The rules that are set, if one is.
    set: Vec<Option<Rule>>,
    roles: Vec<Option<Role>>,
    /// Of each column the flags about it.
    flags: Vec<Vec<usize>>,
    groups: Vec<Group>,
    /// Whether a column is in a group.
    placed: Vec<bool>,
    told: Vec<String>,
}

impl<'a> Planner<'a> {
    fn new(attributes: &'a [Attribute], rules: &Rules, facts: &'a dyn Fn(usize) -> Facts) -> Self {
        let names: Vec<&str> = attributes.iter().map(|a| a.name.as_str()).collect();
        let count = attributes.len();
        Self {
            attributes,
            facts,
            set: names.iter().map(|name| rules.set_for(name)).collect(),
            roles: roles_of(&names),
            flags: vec![Vec::new(); count],
            groups: Vec::new(),
            placed: vec![false; count],
            told: Vec::new(),
        }
    }

    fn plan(mut self) -> Plan {
        self.find_flags();
        for (how, wanted) in QUANTITIES {
            for set in sets(&self.roles, wanted) {
                self.place_quantity(how, set);
            }
            self.place_parts(how, wanted);
        }
        let harmonics = |role: &Option<Role>| role.is_some_and(|role| HARMONICS.contains(&role));
        let harmonics = (0..self.roles.len()).filter(|i| harmonics(&self.roles[*i])).collect();
        self.place_quantity(How::Mean, harmonics);
        for i in 0..self.attributes.len() {
            self.place_single(i);
        }
        let mut rules = vec![Rule::Drop; self.attributes.len()];
        for group in &self.groups {
            for &i in &group.columns {
                let dropped = self.set[i] == Some(Rule::Drop);
                rules[i] = match group.how {
                    _ if dropped => Rule::Drop,
                    How::Mean | How::Normal | How::Rotation => Rule::Mean,
                    How::Nearest | How::Flag => Rule::Nearest,
                };
            }
        }
        Plan { groups: self.groups, rules, told: self.told }
    }

    /// Finds the flags, and places those that have no rule of their own.
    fn find_flags(&mut self) {
        for flag in 0..self.attributes.len() {
            let about = self.flagged_by(flag);
            if about.is_empty() || !(self.facts)(flag).is_flag {
                continue;
            }
            for column in about {
                self.flags[column].push(flag);
            }
            if self.set[flag].is_none() {
                self.place(How::Flag, vec![flag]);
            }
        }
    }

    /// The columns that a column is the flag of, by its name.
    fn flagged_by(&self, flag: usize) -> Vec<usize> {
        let wanted: &[Role] = match self.roles[flag] {
            Some(Role::ColourInvalid) => &COLOUR,
            Some(Role::IntensityInvalid) => &[Role::Intensity],
            Some(Role::TimeInvalid) => &[Role::Time],
            _ => &[],
        };
        let name = self.attributes[flag].name.to_lowercase();
        let stem = name.strip_suffix("_invalid").unwrap_or("");
        let is_about = |i: &usize| match self.roles[*i] {
            Some(role) if wanted.contains(&role) => true,
            _ => *i != flag && wanted.is_empty() && self.attributes[*i].name.to_lowercase() == stem,
        };
        (0..self.attributes.len()).filter(is_about).collect()
    }

    fn place(&mut self, how: How, columns: Vec<usize>) {
        let mut flags = match how {
            How::Flag => columns.clone(),
            _ => columns.iter().flat_map(|i| self.flags[*i].iter().copied()).collect(),
        };
        flags.sort_unstable();
        flags.dedup();
        columns.iter().for_each(|i| self.placed[*i] = true);
        self.groups.push(Group { columns, how, flags });
    }

    /// Places what is one quantity, but for those of its columns that have another rule of their own. Vectors that are not
    /// whole then, or not floats, are left to be placed as parts.
    fn place_quantity(&mut self, how: How, columns: Vec<usize>) {
        let follows = |i: &usize| matches!(self.set[*i], None | Some(Rule::Mean | Rule::Drop));
        let is_vector = matches!(how, How::Normal | How::Rotation);
        let floats = columns.iter().all(|i| self.attributes[*i].values.kind().is_float());
        if is_vector && !(floats && columns.iter().all(follows)) {
            return;
        }
        let columns: Vec<usize> = columns.into_iter().filter(follows).collect();
        if columns.iter().any(|i| self.set[*i] != Some(Rule::Drop)) {
            self.place(how, columns);
        }
    }

    /// Places parts of vectors that are not whole: each by its own rule, or from the nearest point, so that they are at least
    /// those of one vector.
    fn place_parts(&mut self, how: How, wanted: &[Role]) {
        let word = match how {
            How::Normal => "normal",
            How::Rotation => "rotation",
            How::Mean | How::Nearest | How::Flag => return,
        };
        let is_part =
            |i: &usize| !self.placed[*i] && self.roles[*i].is_some_and(|role| wanted.contains(&role));
        let parts: Vec<usize> = (0..self.roles.len()).filter(is_part).collect();
        let floats = parts.iter().all(|i| self.attributes[*i].values.kind().is_float());
        let free: Vec<usize> = parts.into_iter().filter(|i| self.set[*i].is_none()).collect();
        if floats && !free.is_empty() {
            let names: Vec<&str> = free.iter().map(|i| self.attributes[*i].name.as_str()).collect();
            let names = names.join(", ");
            self.told.push(format!("taken from the nearest point, since not a whole {word}: {names}"));
        }
        for i in free {
            self.place(How::Nearest, vec![i]);
        }
    }

    fn place_single(&mut self, i: usize) {
        if self.placed[i] {
            return;
        }
        let Attribute { name, values } = &self.attributes[i];
        let usual = || usual(self.roles[i], name, values.kind(), || (self.facts)(i));
        match self.set[i].unwrap_or_else(usual) {
            Rule::Mean => self.place(How::Mean, vec![i]),
            Rule::Nearest => self.place(How::Nearest, vec![i]),
            Rule::Drop => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use densecloud_cloud::Values;

    fn floats(name: &str) -> Attribute {
        Attribute { name: name.into(), values: Values::F32(vec![0.5, 0.25, 0.75]) }
    }

    fn bytes(name: &str, numbers: [u8; 3]) -> Attribute {
        Attribute { name: name.into(), values: Values::U8(numbers.to_vec()) }
    }

    fn plan(attributes: &[Attribute], rules: &str) -> Plan {
        let rules = if rules.is_empty() { Rules::default() } else { rules.parse().expect("rules") };
        Plan::of(attributes, &rules)
    }

    /// How, the columns and the flags of each group.
    fn groups(plan: &Plan) -> Vec<(How, Vec<usize>, Vec<usize>)> {
        let mut groups: Vec<_> =
            plan.groups.iter().map(|g| (g.how, g.columns.clone(), g.flags.clone())).collect();
        groups.sort_by(|a, b| a.1.cmp(&b.1));
        groups
    }

    #[test]
    fn what_is_one_quantity_goes_together() {
        let names = [
            "nx", "ny", "nz", "f_dc_0", "f_rest_0", "f_dc_1", "f_rest_1", "f_dc_2", "opacity", "scale_0",
            "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3", "R", "B", "G", "normal_x", "normal_y",
            "normal_z",
        ];
        let attributes: Vec<Attribute> = names.iter().map(|name| floats(name)).collect();
        let plan = plan(&attributes, "");
        let alone = Vec::new;
        assert_eq!(
            groups(&plan),
            [
                (How::Normal, vec![0, 1, 2], alone()),
                (How::Mean, vec![3, 4, 5, 6, 7], alone()),
                (How::Mean, vec![8], alone()),
                (How::Mean, vec![9, 10, 11], alone()),
                (How::Rotation, vec![12, 13, 14, 15], alone()),
                (How::Mean, vec![16, 18, 17], alone()),
                (How::Normal, vec![19, 20, 21], alone()),
            ]
        );
        assert!(plan.rules().iter().all(|rule| *rule == Rule::Mean) && plan.warnings().is_empty());
    }

    #[test]
    fn parts_of_a_vector_are_those_of_the_nearest() {
        let attributes: Vec<Attribute> = ["rot_0", "rot_1", "rot_2", "nx", "ny", "nz"].map(floats).into();
        let made = plan(&attributes, "ny:nearest");
        assert_eq!(made.rules(), [Rule::Nearest; 6]);
        assert_eq!(
            made.warnings(),
            [
                "taken from the nearest point, since not a whole normal: nx, nz",
                "taken from the nearest point, since not a whole rotation: rot_0, rot_1, rot_2"
            ]
        );
        // One that is left out is part of it all the same.
        let made = plan(&attributes[3..], "ny:drop,nz:mean");
        assert_eq!(groups(&made), [(How::Normal, vec![0, 1, 2], vec![])]);
        assert_eq!(made.rules(), [Rule::Mean, Rule::Drop, Rule::Mean]);
        assert!(plan(&attributes[3..], "nx:drop,ny:drop,nz:drop").groups.is_empty());
        // Integers are no directions.
        let made = plan(&[bytes("nx", [0, 1, 2]), floats("ny"), floats("nz")], "");
        assert_eq!(made.rules(), [Rule::Nearest; 3]);
        assert!(made.warnings().is_empty());
    }

    #[test]
    fn flags_go_with_what_they_are_about() {
        let attributes = [
            bytes("red", [1, 2, 3]),
            bytes("green", [1, 2, 3]),
            bytes("blue", [1, 2, 3]),
            bytes("isColorInvalid", [0, 1, 0]),
            bytes("row", [1, 2, 3]),
            bytes("Row_invalid", [0, 0, 1]),
            bytes("intensity_invalid", [0, 0, 1]),
            floats("height_invalid"),
            floats("height"),
        ];
        let made = plan(&attributes, "");
        let expected = [
            (How::Mean, vec![0, 1, 2], vec![3]),
            (How::Flag, vec![3], vec![3]),
            (How::Nearest, vec![4], vec![5]),
            (How::Flag, vec![5], vec![5]),
            (How::Nearest, vec![6], vec![]),
            (How::Mean, vec![7], vec![]),
            (How::Mean, vec![8], vec![]),
        ];
        assert_eq!(groups(&made), expected, "no intensity, and no flags in floats");
        let made = plan(&attributes[..4], "red:nearest,isColorInvalid:drop");
        let expected = [(How::Nearest, vec![0], vec![3]), (How::Mean, vec![1, 2], vec![3])];
        assert_eq!(groups(&made), expected);
        assert_eq!(made.kept().collect::<Vec<_>>(), [0, 1, 2]);
    }
}
