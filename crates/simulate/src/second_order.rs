//! Numbers with their first and second derivatives with respect to two parameters.
//!
//! Forward-mode automatic differentiation: a formula that is evaluated with these numbers has exact
//! derivatives. Formulas of derivatives, written by hand, would repeat each form and could contradict it.

use planish_core::DVec3;
use planish_spline::Jet;
use std::ops::{Add, Mul, Sub};

/// A value `f` with its derivatives with respect to `u` and `v`, up to second order.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SecondOrder {
    pub f: f64,
    pub u: f64,
    pub v: f64,
    pub uu: f64,
    pub uv: f64,
    pub vv: f64,
}

impl SecondOrder {
    /// A number that does not depend on the parameters.
    pub fn constant(f: f64) -> Self {
        Self { f, u: 0.0, v: 0.0, uu: 0.0, uv: 0.0, vv: 0.0 }
    }

    /// The two parameters themselves.
    pub fn parameters(u: f64, v: f64) -> [Self; 2] {
        [Self { u: 1.0, ..Self::constant(u) }, Self { v: 1.0, ..Self::constant(v) }]
    }

    /// `g(self)`, given the value and the first two derivatives of `g` at `self.f`.
    pub fn compose(self, [g, d, dd]: [f64; 3]) -> Self {
        Self {
            f: g,
            u: d * self.u,
            v: d * self.v,
            // The chain rule of second order: g'' times the product of the first derivatives, plus g'
            // times the second.
            uu: d * self.uu + dd * self.u * self.u,
            uv: d * self.uv + dd * self.u * self.v,
            vv: d * self.vv + dd * self.v * self.v,
        }
    }

    pub fn sin(self) -> Self {
        let (s, c) = self.f.sin_cos();
        self.compose([s, c, -s])
    }

    pub fn cos(self) -> Self {
        let (s, c) = self.f.sin_cos();
        self.compose([c, -s, -c])
    }

    pub fn exp(self) -> Self {
        let e = self.f.exp();
        self.compose([e, e, e])
    }

    /// The point and derivatives of a surface, given its three coordinates.
    pub fn jet(p: [Self; 3]) -> Jet {
        Jet {
            point: DVec3::from(p.map(|c| c.f)),
            du: DVec3::from(p.map(|c| c.u)),
            dv: DVec3::from(p.map(|c| c.v)),
            duu: DVec3::from(p.map(|c| c.uu)),
            duv: DVec3::from(p.map(|c| c.uv)),
            dvv: DVec3::from(p.map(|c| c.vv)),
        }
    }
}

impl Add for SecondOrder {
    type Output = Self;
    fn add(self, b: Self) -> Self {
        Self {
            f: self.f + b.f,
            u: self.u + b.u,
            v: self.v + b.v,
            uu: self.uu + b.uu,
            uv: self.uv + b.uv,
            vv: self.vv + b.vv,
        }
    }
}

impl Add<f64> for SecondOrder {
    type Output = Self;
    fn add(self, b: f64) -> Self {
        Self { f: self.f + b, ..self }
    }
}

impl Sub<f64> for SecondOrder {
    type Output = Self;
    fn sub(self, b: f64) -> Self {
        Self { f: self.f - b, ..self }
    }
}

impl Mul for SecondOrder {
    type Output = Self;
    fn mul(self, b: Self) -> Self {
        Self {
            f: self.f * b.f,
            u: self.u * b.f + self.f * b.u,
            v: self.v * b.f + self.f * b.v,
            // The product rule, applied twice; mixed derivatives are symmetric and stored once.
            uu: self.uu * b.f + 2.0 * self.u * b.u + self.f * b.uu,
            uv: self.uv * b.f + self.u * b.v + self.v * b.u + self.f * b.uv,
            vv: self.vv * b.f + 2.0 * self.v * b.v + self.f * b.vv,
        }
    }
}

impl Mul<f64> for SecondOrder {
    type Output = Self;
    fn mul(self, s: f64) -> Self {
        Self {
            f: s * self.f,
            u: s * self.u,
            v: s * self.v,
            uu: s * self.uu,
            uv: s * self.uv,
            vv: s * self.vv,
        }
    }
}
