//! The two sides of a comparison, read from files.

use super::*;
use planish_core::SymmetricMatrix3;

/// A model to be compared.
#[derive(Debug, Clone)]
pub enum Compared {
    /// A spline with its covariance.
    Surface(Box<SurfaceModel>),
    /// A mesh with values at its vertices.
    Mesh(ComparedMesh),
}

/// A mesh whose vertices may carry σ, `observed` and curvature.
#[derive(Debug, Clone, Default)]
pub struct ComparedMesh {
    /// Positions and triangles.
    pub mesh: TriangleMesh,
    /// σ along the normal.
    pub sigma: Option<Vec<f64>>,
    /// Whether each vertex was measured.
    pub observed: Option<Vec<Observed>>,
    /// Mean and Gaussian curvature of each vertex, positive towards the normal; NaN where unknown.
    pub curvature: [Option<Vec<f64>>; 2],
    /// Unit of every length, if the file states it.
    pub unit: Option<Unit>,
}

/// The reference of a comparison.
#[derive(Debug, Clone, Default)]
pub struct Reference {
    /// Its points: the vertices of a mesh, or a cloud.
    pub points: Vec<DVec3>,
    /// Unit normals. Zero if unknown; absent if no point has one.
    pub normals: Option<Vec<DVec3>>,
    /// Triangles between the points; none for a cloud.
    pub triangles: Vec<[u32; 3]>,
    /// Covariances of the points. Zero if not stated; absent if the reference counts as exact.
    pub covariance: Option<Vec<SymmetricMatrix3>>,
    /// Unit of every length, if a file states it.
    pub unit: Option<Unit>,
}

impl ComparedMesh {
    /// A mesh as it was read from a file, with its columns `sigma` and `observed`.
    ///
    /// # Errors
    /// `Input` for a σ that is negative or not finite, and for triangles that make no mesh.
    pub(crate) fn from_file(file: PolygonMesh, path: &Path) -> Result<Self> {
        let sigma = file.column("sigma").map(<[f64]>::to_vec);
        if let Some(at) = sigma.iter().flatten().position(|s| !(s.is_finite() && *s >= 0.0)) {
            return Err(Error::input(format!(
                "{}: vertex {at}: expected sigma ≥ 0, found {}",
                path.display(),
                sigma.unwrap_or_default()[at]
            )));
        }
        let curvature =
            ["mean_curvature", "gaussian_curvature"].map(|name| file.column(name).map(<[f64]>::to_vec));
        Ok(Self {
            sigma,
            curvature,
            observed: file
                .column("observed")
                .map(|column| column.iter().map(|&mark| observed_of(mark)).collect()),
            unit: file.unit,
            mesh: TriangleMesh::try_new(file.points, file.triangles)
                .map_err(|e| e.in_context(path.display()))?,
        })
    }
}

impl Compared {
    /// Reads a `.planish` model, a mesh (PLY, OBJ, STL, OFF or GLB) or the faces of a STEP file.
    ///
    /// # Errors
    /// As the readers; `Unsupported` for other extensions; `Input` for a mesh without triangles or with a σ
    /// that is negative or not finite.
    pub fn read(path: &Path) -> Result<Self> {
        match planish_exchange::extension(path).as_str() {
            "planish" => Ok(Self::Surface(Box::new(saved::load(path)?))),
            _ if has_faces(path) => {
                let file = read_mesh(path)?;
                if file.triangles.is_empty() {
                    return Err(Error::input(format!(
                        "{}: expected a model with a surface, found points only: give them as the reference",
                        path.display()
                    )));
                }
                ComparedMesh::from_file(file, path).map(Self::Mesh)
            }
            _ => Err(Error::unsupported(format!(
                "{}: expected a model (.planish), a mesh (.ply, .obj, .stl, .off, .glb) or faces (.step), \
                 found {}",
                path.display(),
                planish_exchange::describe_extension(path)
            ))),
        }
    }

    /// The unit that the file states, if it does.
    pub(crate) fn unit(&self) -> Option<Unit> {
        match self {
            Self::Surface(model) => (!model.unit_assumed).then_some(model.unit),
            Self::Mesh(mesh) => mesh.unit,
        }
    }

    /// Takes the lengths of a file that states no unit as lengths in `unit`.
    #[must_use]
    pub(crate) fn with_unit_if_unstated(mut self, unit: Option<Unit>) -> Self {
        if let (None, Some(unit)) = (self.unit(), unit) {
            match &mut self {
                Self::Surface(model) => (model.unit, model.unit_assumed) = (unit, false),
                Self::Mesh(mesh) => mesh.unit = Some(unit),
            }
        }
        self
    }
}

impl Reference {
    /// Reads a mesh or a point cloud in any format that a fit can read.
    ///
    /// σ is taken from the columns `sigma` or `cxx cxy cxz cyy cyz czz` of a mesh file, or from the sensors
    /// of a job file.
    ///
    /// # Errors
    /// Those of the readers; `Input` for a σ that is not positive.
    pub fn read(path: &Path) -> Result<Self> {
        if !has_faces(path) {
            return Ok(Self::from_scans(&read_inputs(&[path], None)?));
        }
        let file = read_mesh(path)?;
        if file.points.is_empty() {
            return Err(Error::input(format!("{}: expected points, found none", path.display())));
        }
        let made = Self {
            covariance: covariances(&file).map_err(|e| e.in_context(path.display()))?,
            // Columns of the file, which only a cloud keeps (see below).
            normals: normals(&file),
            unit: file.unit,
            points: file.points,
            triangles: file.triangles,
        };
        let Self { points, triangles, .. } = &made;
        if triangles.is_empty() {
            // A cloud keeps the normals of its file.
            return Ok(made);
        }
        let mesh = TriangleMesh::try_new(points.clone(), triangles.clone())
            .map_err(|e| e.in_context(path.display()))?;
        // Normals from the triangles, even if the file has some: they must agree with the faces that are
        // measured to.
        Ok(Self { normals: Some(mesh.vertex_normals()), ..made })
    }

    /// The points of scans, in world coordinates.
    #[must_use]
    pub fn from_scans(set: &ScanSet) -> Self {
        let mut made = Self { unit: set.unit, ..Self::default() };
        let (mut normals, mut covariance) = (Vec::new(), Vec::new());
        for posed in &set.scans {
            let scan = &posed.scan;
            let pose = &scan.world_from_scanner;
            for k in 0..scan.points.len() {
                made.points.push(pose.apply(scan.points[k]));
                let normal = scan.normals.as_ref().map_or(DVec3::ZERO, |n| n[k].normalize_or_zero());
                normals.push(pose.rotate(normal));
                // The most specific statement counts: the covariance of a point, its σ, then the sensor.
                let stated = match (&scan.covariance, &scan.sigma, set.sensors[posed.sensor].noise) {
                    (Some(all), _, _) => all[k].rotated(&pose.rotation),
                    (None, Some(sigmas), _) => SymmetricMatrix3::isotropic(sigmas[k] * sigmas[k]),
                    (None, None, Some(noise)) => noise.covariance(None),
                    (None, None, None) => SymmetricMatrix3::ZERO,
                };
                covariance.push(stated);
            }
        }
        let known = |n: &DVec3| *n != DVec3::ZERO;
        made.normals = normals.iter().any(known).then_some(normals);
        made.covariance = covariance.iter().any(|c| *c != SymmetricMatrix3::ZERO).then_some(covariance);
        made
    }

    /// Multiplies all lengths by `factor`.
    pub(super) fn scaled(mut self, factor: f64) -> Self {
        // Without conversion, the numbers stay exactly those of the file.
        if factor != 1.0 {
            self.points.iter_mut().for_each(|p| *p = factor * *p);
            self.covariance.iter_mut().flatten().for_each(|c| *c = c.scaled(factor).scaled(factor));
        }
        self
    }

    pub(super) fn normal(&self, k: usize) -> DVec3 {
        self.normals.as_ref().map_or(DVec3::ZERO, |n| n[k])
    }

    pub(super) fn variance(&self, k: usize, direction: DVec3) -> f64 {
        self.covariance.as_ref().map_or(0.0, |c| c[k].along(direction))
    }
}

fn covariances(file: &PolygonMesh) -> Result<Option<Vec<SymmetricMatrix3>>> {
    if let Some(sigma) = file.column("sigma") {
        if let Some(at) = sigma.iter().position(|s| !(s.is_finite() && *s >= 0.0)) {
            return Err(Error::input(format!("vertex {at}: expected sigma ≥ 0, found {}", sigma[at])));
        }
        // σ is along the normal. Isotropic noise has the same σ there, and only that direction is used.
        return Ok(Some(sigma.iter().map(|&s| SymmetricMatrix3::isotropic(s * s)).collect()));
    }
    let columns = ["cxx", "cxy", "cxz", "cyy", "cyz", "czz"].map(|name| file.column(name));
    let [Some(a), Some(b), Some(c), Some(d), Some(e), Some(f)] = columns else {
        return Ok(None);
    };
    let all: Vec<SymmetricMatrix3> =
        (0..a.len()).map(|k| SymmetricMatrix3::from_array([a[k], b[k], c[k], d[k], e[k], f[k]])).collect();
    // A cheap necessary test. It finds exchanged columns, the usual mistake.
    let possible = |c: &SymmetricMatrix3| c.is_finite() && c.xx >= 0.0 && c.yy >= 0.0 && c.zz >= 0.0;
    if let Some(at) = all.iter().position(|c| !possible(c)) {
        return Err(Error::input(format!(
            "vertex {at}: expected a covariance cxx cxy cxz cyy cyz czz, found {}",
            all[at].to_array().map(|v| v.to_string()).join(" ")
        )));
    }
    Ok(Some(all))
}

fn normals(file: &PolygonMesh) -> Option<Vec<DVec3>> {
    let [Some(x), Some(y), Some(z)] = ["nx", "ny", "nz"].map(|name| file.column(name)) else {
        return None;
    };
    // Files mark unknown normals by zeros or NaN.
    Some((0..x.len()).map(|k| DVec3::new(x[k], y[k], z[k]).normalize_or_zero()).collect())
}
