//! A small convolutional network that classifies glyphs.
//!
//! Weights have 8 bits and a scale for every unit. `benches/peers/glyphs/train.py` trains and writes them.

use super::shape::{GRID, Glyph, PLACES};

/// The characters of the classes in their order; the last class, which has none, is everything else.
pub(super) const CLASSES: &str =
    "0123456789.,:-+±°Ø×/%()=ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwyzäöüé";
/// Number of classes, including the one of shapes that are no glyphs.
pub(super) const CLASS_COUNT: usize = 80;
/// Class of shapes that are no glyphs.
pub(super) const NO_GLYPH: usize = CLASS_COUNT - 1;

const WEIGHTS: &[u8] = include_bytes!("network.bin");
const KERNEL: usize = 5;
const MAPS: [usize; 2] = [12, 24];
const HIDDEN: usize = 96;

/// Units that take weighted sums of the same number of inputs.
struct Layer {
    weights: Vec<Vec<f32>>,
    biases: Vec<f32>,
}

impl Layer {
    /// Takes the next layer from the bytes: scales, biases, then the weights unit by unit.
    fn take(bytes: &mut &[u8], units: usize, inputs: usize) -> Self {
        let mut floats = || -> Vec<f32> {
            let (own, rest) = bytes.split_at(4 * units);
            *bytes = rest;
            own.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect()
        };
        let (scales, biases) = (floats(), floats());
        let (own, rest) = bytes.split_at(units * inputs);
        *bytes = rest;
        let unit = |(row, scale): (&[u8], &f32)| row.iter().map(|b| f32::from(*b as i8) * scale).collect();
        Self { weights: own.chunks_exact(inputs).zip(&scales).map(unit).collect(), biases }
    }

    fn of(&self, inputs: &[f32]) -> Vec<f32> {
        let sum = |w: &Vec<f32>| w.iter().zip(inputs).map(|(w, x)| w * x).sum::<f32>();
        self.weights.iter().zip(&self.biases).map(|(w, bias)| bias + sum(w)).collect()
    }

    /// Convolution with stride 2 and zeros around the grid: rows × columns × maps in and out, then ReLU.
    fn convolved(&self, inputs: &[f32], side: usize, maps: usize) -> Vec<f32> {
        let padded_side = side + KERNEL - 1;
        let mut padded = vec![0.0; padded_side * padded_side * maps];
        for row in 0..side {
            let at = ((row + KERNEL / 2) * padded_side + KERNEL / 2) * maps;
            padded[at..at + side * maps].copy_from_slice(&inputs[row * side * maps..][..side * maps]);
        }
        let mut out = Vec::with_capacity((side / 2).pow(2) * self.biases.len());
        let mut patch = Vec::with_capacity(KERNEL * KERNEL * maps);
        for row in (0..side).step_by(2) {
            for column in (0..side).step_by(2) {
                patch.clear();
                for k in 0..KERNEL {
                    let at = ((row + k) * padded_side + column) * maps;
                    patch.extend_from_slice(&padded[at..at + KERNEL * maps]);
                }
                out.extend(self.of(&patch).into_iter().map(|v| v.max(0.0)));
            }
        }
        out
    }
}

/// The network with its weights.
pub(super) struct Network {
    temperature: f32,
    convolutions: [Layer; 2],
    hidden: Layer,
    last: Layer,
}

impl Network {
    pub(super) fn new() -> Self {
        let mut bytes = &WEIGHTS[4..];
        let cells = (GRID / 4).pow(2);
        Self {
            temperature: f32::from_le_bytes([WEIGHTS[0], WEIGHTS[1], WEIGHTS[2], WEIGHTS[3]]),
            convolutions: [
                Layer::take(&mut bytes, MAPS[0], KERNEL * KERNEL),
                Layer::take(&mut bytes, MAPS[1], KERNEL * KERNEL * MAPS[0]),
            ],
            hidden: Layer::take(&mut bytes, HIDDEN, cells * MAPS[1] + PLACES),
            last: Layer::take(&mut bytes, CLASS_COUNT, HIDDEN),
        }
    }

    /// Probability of every class.
    pub(super) fn chances(&self, glyph: &Glyph) -> [f32; CLASS_COUNT] {
        let first = self.convolutions[0].convolved(&glyph.cells, GRID, 1);
        let mut features = self.convolutions[1].convolved(&first, GRID / 2, MAPS[0]);
        features.extend(glyph.place);
        let hidden: Vec<f32> = self.hidden.of(&features).into_iter().map(|v| v.max(0.0)).collect();
        let scores = self.last.of(&hidden);
        let top = scores.iter().copied().fold(f32::MIN, f32::max);
        let mut chances = [0.0; CLASS_COUNT];
        for (chance, score) in chances.iter_mut().zip(scores) {
            *chance = ((score - top) / self.temperature).exp();
        }
        let total: f32 = chances.iter().sum();
        chances.map(|c| c / total)
    }
}
