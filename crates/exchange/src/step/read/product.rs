//! Reads units, representations and assemblies of STEP files.
//!
//! # References
//! ISO 10303-41 (units, products), ISO 10303-43 (representations and their relationships), ISO 10303-44
//! (assemblies).

use super::attributes::{Entity, part};
use super::geometry::{Frame, Geometry};
use super::syntax::Index;
use planish_core::DVec3;
use planish_estimate::{Error, Result};
use std::collections::{BTreeMap, HashMap};

/// Maximum nesting of units that are defined by other units; finds cycles.
const MAX_DEPTH: usize = 8;

/// An affine map: the columns of its matrix, and a translation. Copies may scale and mirror.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Motion {
    columns: [DVec3; 3],
    shift: DVec3,
}

impl Motion {
    pub(super) const NONE: Self = Self { columns: [DVec3::X, DVec3::Y, DVec3::Z], shift: DVec3::ZERO };

    fn turn(&self, d: DVec3) -> DVec3 {
        let [x, y, z] = self.columns;
        d[0] * x + d[1] * y + d[2] * z
    }

    pub(super) fn apply(&self, p: DVec3) -> DVec3 {
        self.turn(p) + self.shift
    }

    /// Composition that applies `first` first.
    pub(super) fn after(&self, first: &Self) -> Self {
        Self { columns: first.columns.map(|c| self.turn(c)), shift: self.apply(first.shift) }
    }

    /// True if the map mirrors.
    pub(super) fn is_mirror(&self) -> bool {
        let [x, y, z] = self.columns;
        x.cross(y).dot(z) < 0.0
    }

    /// Map from the coordinates of a frame to those in which the frame is given.
    fn out_of(frame: &Frame) -> Self {
        Self { columns: [frame.x, frame.y, frame.z], shift: frame.origin }
    }

    /// Map into the coordinates of a frame; the inverse of [`Motion::out_of`].
    fn into(frame: &Frame) -> Self {
        let axes = [frame.x, frame.y, frame.z];
        let columns = [0, 1, 2].map(|c| DVec3::from_array(axes.map(|a| a[c])));
        Self { columns, shift: DVec3::from_array(axes.map(|a| -a.dot(frame.origin))) }
    }
}

/// Units of a context.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Units {
    /// Unit of lengths in millimetres; none if the file states none.
    pub(super) length_mm: Option<f64>,
    /// Unit of angles in radians.
    pub(super) angle: f64,
    /// Maximum distance of points that coincide, in the unit of lengths.
    pub(super) uncertainty: Option<f64>,
}

impl Units {
    pub(super) const NONE: Self = Self { length_mm: None, angle: 1.0, uncertainty: None };

    /// Reads the units of the context of a representation.
    pub(super) fn of_context(index: &Index, id: u64) -> Result<Self> {
        let parts = index.parts(id)?;
        let mut found = Self::NONE;
        let given = part(&parts, "GLOBAL_UNIT_ASSIGNED_CONTEXT").map(|p| p.references(0)).transpose()?;
        for unit in given.unwrap_or_default() {
            match size_of_unit(index, unit, 0)? {
                Some(("LENGTH_UNIT", metres)) => found.length_mm = Some(1000.0 * metres),
                Some(("PLANE_ANGLE_UNIT", radians)) => found.angle = radians,
                _ => {}
            }
        }
        // After the units, because the uncertainty is converted to the unit of lengths.
        let uncertain =
            part(&parts, "GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT").map(|p| p.references(0)).transpose()?;
        for id in uncertain.unwrap_or_default() {
            let measure = index.entity(id)?;
            let (value, unit) = (measure.number(0)?, size_of_unit(index, measure.reference(1)?, 0)?);
            if let (Some(("LENGTH_UNIT", metres)), Some(mm)) = (unit, found.length_mm) {
                // Converted to the unit of lengths, because it may be stated in another one.
                found.uncertainty = Some(value * 1000.0 * metres / mm);
            }
        }
        Ok(found)
    }
}

/// Kind of a unit, and its size in metres or radians; none for other kinds.
fn size_of_unit(index: &Index, id: u64, depth: usize) -> Result<Option<(&'static str, f64)>> {
    if depth > MAX_DEPTH {
        return Err(Error::input(format!("#{id}: expected a unit, found a cycle of units")));
    }
    let parts = index.parts(id)?;
    let kinds = ["LENGTH_UNIT", "PLANE_ANGLE_UNIT"];
    let Some(kind) = kinds.into_iter().find(|k| part(&parts, k).is_some()) else {
        return Ok(None);
    };
    if let Some(si) = part(&parts, "SI_UNIT") {
        return Ok(Some((kind, prefix(si)?)));
    }
    let Some(based) = part(&parts, "CONVERSION_BASED_UNIT") else {
        return Ok(None);
    };
    // Subtypes of the measure differ by exporter; each has a value and its unit.
    let measure = index.parts(based.reference(1)?)?;
    let (value, unit) = match measure.as_slice() {
        [one] => (one.number(0)?, one.reference(1)?),
        several => {
            let with_unit = part(several, "MEASURE_WITH_UNIT")
                .ok_or_else(|| based.wrong("expected a measure with its unit, found none"))?;
            (with_unit.number(0)?, with_unit.reference(1)?)
        }
    };
    // A unit of another kind as the base counts as the SI unit.
    let base = size_of_unit(index, unit, depth + 1)?.map_or(1.0, |(_, size)| size);
    match value > 0.0 {
        true => Ok(Some((kind, value * base))),
        false => Err(based.wrong(&format!("expected a factor > 0, found {value}"))),
    }
}

fn prefix(si: &Entity) -> Result<f64> {
    use super::syntax::Value::{Name, Omitted};
    Ok(match si.value(0) {
        Some(Omitted) => 1.0,
        Some(Name(b"KILO")) => 1e3,
        Some(Name(b"HECTO")) => 1e2,
        Some(Name(b"DECA")) => 1e1,
        Some(Name(b"DECI")) => 1e-1,
        Some(Name(b"CENTI")) => 1e-2,
        Some(Name(b"MILLI")) => 1e-3,
        Some(Name(b"MICRO")) => 1e-6,
        Some(Name(b"NANO")) => 1e-9,
        _ => return Err(si.wrong("expected an SI prefix of lengths, or $, found another value")),
    })
}

/// A shape representation and its items.
#[derive(Debug, Clone)]
pub(super) struct Representation {
    pub(super) items: Vec<u64>,
    pub(super) units: Units,
    /// True if its keyword is the general `SHAPE_REPRESENTATION`.
    is_plain: bool,
}

/// Placement of a representation, or a copy of it, in another one.
#[derive(Debug, Clone, Copy)]
struct Within {
    child: u64,
    parent: u64,
    /// Frames of the child and of the parent; for a copy, the second may be an operator.
    frames: [u64; 2],
}

/// Representations and their placements.
pub(super) struct Products {
    pub(super) representations: BTreeMap<u64, Representation>,
    within: Vec<Within>,
    /// Representations with a common frame: maps each to an earlier one.
    same: HashMap<u64, u64>,
}

impl Products {
    /// Finds the shape representations of a file and the placements between them.
    ///
    /// # Errors
    /// `Input` for instances that are missing or malformed.
    pub(super) fn find(index: &Index) -> Result<Self> {
        let mut found = Self { representations: BTreeMap::new(), within: Vec::new(), same: HashMap::new() };
        let mut contexts: HashMap<u64, Units> = HashMap::new();
        let mut add = |found: &mut Self, id: u64, items: Vec<u64>, context: u64| -> Result<()> {
            // Many representations share a context, which is read once.
            let units = match contexts.get(&context) {
                Some(units) => *units,
                None => Units::of_context(index, context)?,
            };
            contexts.insert(context, units);
            let is_plain = index.of_keyword("SHAPE_REPRESENTATION").contains(&id);
            found.representations.insert(id, Representation { items, units, is_plain });
            Ok(())
        };
        let is_shape = |keyword: &str| {
            keyword.ends_with("SHAPE_REPRESENTATION") && keyword != "CONTEXT_DEPENDENT_SHAPE_REPRESENTATION"
        };
        // The order of keywords is arbitrary, which is harmless: the result is a sorted map.
        for (_, ids) in index.keywords().filter(|(keyword, _)| is_shape(keyword)) {
            for id in ids {
                let entity = index.entity(*id)?;
                add(&mut found, *id, entity.references(1)?, entity.reference(2)?)?;
            }
        }
        for id in index.complex() {
            let parts = index.parts(*id)?;
            // Draughting models contain the shape once more, with annotations.
            let is_drawing = part(&parts, "DRAUGHTING_MODEL").is_some();
            if !is_drawing
                && parts.iter().any(|p| is_shape(p.record.keyword))
                && let Some(base) = part(&parts, "REPRESENTATION")
            {
                add(&mut found, *id, base.references(1)?, base.reference(2)?)?;
            }
            if let (Some(moved), Some(pair)) = (
                part(&parts, "REPRESENTATION_RELATIONSHIP_WITH_TRANSFORMATION"),
                part(&parts, "REPRESENTATION_RELATIONSHIP"),
            ) {
                let operator = index.entity(moved.reference(0)?)?;
                if operator.record.keyword == "ITEM_DEFINED_TRANSFORMATION" {
                    found.within.push(Within {
                        child: pair.reference(2)?,
                        parent: pair.reference(3)?,
                        frames: [operator.reference(2)?, operator.reference(3)?],
                    });
                }
            }
        }
        // Such a relationship joins representations in one frame, for example a product and its geometry.
        for id in index.of_keyword("SHAPE_REPRESENTATION_RELATIONSHIP") {
            let entity = index.entity(*id)?;
            let [a, b] = [entity.reference(2)?, entity.reference(3)?].map(|r| found.first_of(r));
            if a != b {
                // Larger numbers refer to smaller ones, so that chains end and contain no cycle.
                found.same.insert(a.max(b), a.min(b));
            }
        }
        let maps: Vec<(u64, u64)> = found
            .representations
            .iter()
            .flat_map(|(id, r)| r.items.iter().map(|item| (*id, *item)))
            .collect();
        for (parent, item) in maps {
            if let Ok([mapped]) = <[Entity; 1]>::try_from(index.parts(item)?)
                && mapped.record.keyword == "MAPPED_ITEM"
            {
                let map = index.entity_of(mapped.reference(1)?, "REPRESENTATION_MAP")?;
                found.within.push(Within {
                    child: map.reference(1)?,
                    parent,
                    frames: [map.reference(0)?, mapped.reference(2)?],
                });
            }
        }
        Ok(found)
    }

    /// Representations, plain ones last. These may repeat items of others, for example to attach a note, so
    /// the others claim their items first.
    pub(super) fn specialised_first(&self) -> impl Iterator<Item = (&u64, &Representation)> {
        let selected = |plain: bool| self.representations.iter().filter(move |(_, r)| r.is_plain == plain);
        selected(false).chain(selected(true))
    }

    /// First of the representations that share a frame with the given one.
    fn first_of(&self, mut id: u64) -> u64 {
        while let Some(next) = self.same.get(&id) {
            id = *next;
        }
        id
    }

    /// All placements of each representation.
    ///
    /// # Errors
    /// `Input` if an assembly contains itself; `Unsupported` if it has more than `max_parts` parts.
    pub(super) fn places(
        &self,
        index: &Index,
        length: &dyn Fn(&Units) -> f64,
        max_parts: usize,
    ) -> Result<BTreeMap<u64, Vec<Motion>>> {
        let mut children: HashMap<u64, Vec<(u64, Motion)>> = HashMap::new();
        let mut is_child: HashMap<u64, bool> = HashMap::new();
        for within in &self.within {
            let (child, parent) = (self.first_of(within.child), self.first_of(within.parent));
            let motion = self.motion(index, within, length)?;
            children.entry(parent).or_default().push((child, motion));
            is_child.insert(child, true);
        }
        let mut places: HashMap<u64, Vec<Motion>> = HashMap::new();
        // Sorted, so that placements do not depend on the order of a hash map.
        let mut firsts: Vec<u64> = self.representations.keys().map(|id| self.first_of(*id)).collect();
        firsts.sort_unstable();
        firsts.dedup();
        let mut total = 0;
        // Representations that are not part of another one are the roots of assemblies.
        for root in firsts.iter().filter(|id| !is_child.contains_key(id)) {
            let mut open = vec![(*root, Motion::NONE, 0)];
            while let Some((id, motion, depth)) = open.pop() {
                total += 1;
                // A path longer than the number of representations visits one of them twice.
                if depth > self.representations.len() {
                    return Err(Error::input(format!(
                        "#{id}: expected a tree of parts, found an assembly that contains itself"
                    )));
                }
                if total > max_parts {
                    return Err(Error::unsupported(format!(
                        "expected an assembly of at most {max_parts} parts, found more"
                    )));
                }
                places.entry(id).or_default().push(motion);
                for (child, within) in children.get(&id).into_iter().flatten() {
                    open.push((*child, motion.after(within), depth + 1));
                }
            }
        }
        // Without a root, each representation is part of another one, so there is a cycle.
        if places.is_empty() && !self.representations.is_empty() {
            return Err(Error::input("expected a tree of parts, found an assembly that contains itself"));
        }
        let placements_of = |id: &u64| places.get(&self.first_of(*id)).cloned().unwrap_or_default();
        Ok(self.representations.keys().map(|id| (*id, placements_of(id))).collect())
    }

    /// Map from the coordinates of a child to those of its parent.
    fn motion(&self, index: &Index, within: &Within, length: &dyn Fn(&Units) -> f64) -> Result<Motion> {
        let geometry = |id: u64| {
            let units = self.representations.get(&id).map_or(Units::NONE, |r| r.units);
            Geometry { index, length: length(&units), angle: units.angle }
        };
        // Each frame is in the units of its own representation, and these may differ.
        let [mut from, mut to] = within.frames;
        // Some exporters swap the frames. Each frame is an item of its own representation, which shows the
        // swap.
        let holds =
            |id: u64, item: u64| self.representations.get(&id).is_some_and(|r| r.items.contains(&item));
        if holds(within.parent, from) && holds(within.child, to) && !holds(within.child, from) {
            std::mem::swap(&mut from, &mut to);
        }
        let into = Motion::into(&geometry(within.child).frame(from)?);
        let target = index.entity(to)?;
        let out = match target.record.keyword {
            "CARTESIAN_TRANSFORMATION_OPERATOR_3D" => operator(&geometry(within.parent), &target)?,
            _ => Motion::out_of(&geometry(within.parent).frame(to)?),
        };
        Ok(out.after(&into))
    }
}

/// `CARTESIAN_TRANSFORMATION_OPERATOR_3D(name, description, name, axis1, axis2, origin, scale, axis3)`.
fn operator(geometry: &Geometry, entity: &Entity) -> Result<Motion> {
    // Depending on the schema, the names of the supertypes are one attribute or two, so the attributes are
    // located by their content: the origin is the first point.
    let first =
        (0..entity.record.values.len()).find(|k| entity.optional(*k).is_ok_and(|v| v.is_some())).unwrap_or(0);
    let at_origin = (first..entity.record.values.len()).find(|k| {
        let id = entity.optional(*k).ok().flatten();
        id.is_some_and(|id| geometry.point(id).is_ok())
    });
    let Some(at) = at_origin.filter(|at| *at >= 2) else {
        return Err(entity.wrong("expected a point as its origin, found none"));
    };
    let axis = |k: usize| -> Result<Option<DVec3>> {
        match entity.optional(k)? {
            Some(id) => Ok(Some(geometry.direction(id)?)),
            None => Ok(None),
        }
    };
    let z = axis(at + 2)?.unwrap_or(DVec3::Z);
    let wanted = axis(at - 2)?.unwrap_or(DVec3::X);
    let x = (wanted - wanted.dot(z) * z)
        .try_normalize()
        .ok_or_else(|| entity.wrong("expected directions that are not parallel, found parallel ones"))?;
    let mut y = z.cross(x);
    // The second axis only determines the handedness.
    if axis(at - 1)?.is_some_and(|given| given.dot(y) < 0.0) {
        y = -y;
    }
    let size = match entity.value(at + 1) {
        Some(super::syntax::Value::Number(s)) => *s,
        _ => 1.0,
    };
    let origin_id = entity.reference(at)?;
    Ok(Motion { columns: [x, y, z].map(|c| size * c), shift: geometry.point(origin_id)? })
}
