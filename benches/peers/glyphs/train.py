"""Trains the network of the glyph reader and writes its weights, quantised to 8 bits.

Layers: convolution 5 × 5, stride 2, 12 maps; convolution 5 × 5, stride 2, 24 maps; 96 units that also take
the four numbers of a glyph's place; classes. ReLU in between, cross entropy, Adam, seeded. The temperature of
the probabilities is fitted to fonts that the training did not see. Prints the accuracy on those and on further
fonts, for stored weights too (`--judge`). `fonts.md` has the commands of the stored weights. Needs jax and
opencv-python-headless.

    python benches/peers/glyphs/train.py train1.npz train2.npz --calibrate calibrate.npz --test test.npz \
        --out crates/exchange/src/glyphs/network.bin
"""

import argparse
import struct

import jax
import jax.numpy as jnp
import numpy as np
from fonts import CLASSES
from samples import GRID, REJECT

MAPS, UNITS, PLACES, KERNEL = (12, 24), 96, 4, 5
SIDE = GRID // 4
# Names and shapes of the layers in the order of the file; the last axis has one scale for each entry.
SHAPES = {
    "first": (KERNEL, KERNEL, 1, MAPS[0]),
    "second": (KERNEL, KERNEL, *MAPS),
    "hidden": (SIDE * SIDE * MAPS[1] + PLACES, UNITS),
    "last": (UNITS, len(CLASSES) + 1),
}


def initial(key):
    keys = jax.random.split(key, len(SHAPES))
    weights = {}
    for (name, shape), own in zip(SHAPES.items(), keys, strict=True):
        weights[name] = jax.random.normal(own, shape) * np.sqrt(2 / np.prod(shape[:-1]))
        weights[name + "_bias"] = jnp.zeros(shape[-1])
    return weights


def logits(weights, pictures, places, drop=None):
    convolved = lambda x, name: jax.nn.relu(
        jax.lax.conv_general_dilated(
            x, weights[name], (2, 2), ((2, 2), (2, 2)), dimension_numbers=("NHWC", "HWIO", "NHWC")
        )
        + weights[name + "_bias"]
    )
    x = convolved(convolved(pictures[..., None], "first"), "second")
    x = jnp.concatenate([x.reshape(len(x), -1), places], 1)
    x = jax.nn.relu(x @ weights["hidden"] + weights["hidden_bias"])
    if drop is not None:
        x = x * jax.random.bernoulli(drop, 0.8, x.shape) / 0.8
    return x @ weights["last"] + weights["last_bias"]


def loss(weights, pictures, places, labels, drop):
    log = jax.nn.log_softmax(logits(weights, pictures, places, drop))
    return -jnp.take_along_axis(log, labels[:, None], 1).mean()


@jax.jit
def step(weights, moments, pictures, places, labels, rate, count, key):
    value, gradient = jax.value_and_grad(loss)(weights, pictures / 255.0, places, labels, key)
    first = jax.tree.map(lambda m, g: 0.9 * m + 0.1 * g, moments[0], gradient)
    second = jax.tree.map(lambda m, g: 0.999 * m + 0.001 * g * g, moments[1], gradient)
    move = lambda w, a, b: (
        w - rate * ((a / (1 - 0.9**count)) / (jnp.sqrt(b / (1 - 0.999**count)) + 1e-8) + 1e-4 * w)
    )
    return jax.tree.map(move, weights, first, second), (first, second), value


def train(samples, epochs, batch, seed):
    pictures, places, labels = samples
    rng, key = np.random.default_rng(seed), jax.random.key(seed)
    weights = initial(key)
    moments = (jax.tree.map(jnp.zeros_like, weights), jax.tree.map(jnp.zeros_like, weights))
    steps, count = epochs * (len(labels) // batch), 0
    for epoch in range(epochs):
        order, total = rng.permutation(len(labels)), []
        for k in range(len(labels) // batch):
            own = np.sort(order[k * batch : (k + 1) * batch])
            count += 1
            rate = 2e-3 * 0.5 * (1 + np.cos(np.pi * count / steps)) * min(1, count / 200)
            shown = pictures[own].astype(np.float32)
            weights, moments, value = step(
                weights,
                moments,
                shown,
                places[own],
                labels[own],
                rate,
                float(count),
                jax.random.fold_in(key, count),
            )
            total.append(value)
        print(f"epoch {epoch + 1}: loss {float(np.mean(total)):.4f}", flush=True)
    return weights


def quantised(weights):
    """Weights in 8 bits with a scale for every unit; biases in 32."""
    rounded, parts = {}, []
    for name in SHAPES:
        w = np.asarray(weights[name], np.float32)
        scale = (np.abs(w).reshape(-1, w.shape[-1]).max(0) / 127 + 1e-12).astype(np.float32)
        steps = np.clip(np.round(w / scale), -127, 127).astype(np.int8)
        bias = np.asarray(weights[name + "_bias"], np.float32)
        rounded[name], rounded[name + "_bias"] = steps * scale, bias
        parts += [scale.tobytes(), bias.tobytes(), steps.reshape(-1, w.shape[-1]).T.tobytes()]
    return rounded, b"".join(parts)


def stored(path):
    """The weights and the temperature of a file."""
    data, at, weights = open(path, "rb").read(), 4, {}
    for name, shape in SHAPES.items():
        units, inputs = shape[-1], int(np.prod(shape[:-1]))
        scale = np.frombuffer(data, "<f4", units, at)
        weights[name + "_bias"] = np.frombuffer(data, "<f4", units, at + 4 * units)
        steps = np.frombuffer(data, np.int8, units * inputs, at + 8 * units).reshape(units, inputs)
        weights[name] = (steps.T * scale).reshape(shape).astype(np.float32)
        at += units * (8 + inputs)
    return weights, struct.unpack("<f", data[:4])[0]


def judged(weights, samples):
    pictures, places, labels = samples
    apply = jax.jit(logits)
    parts = [
        apply(weights, pictures[k : k + 2000] / np.float32(255), places[k : k + 2000])
        for k in range(0, len(labels), 2000)
    ]
    return np.concatenate(parts), labels


def fitted_temperature(values, labels):
    def cost(t):
        log = jax.nn.log_softmax(values / t)
        return float(-np.take_along_axis(np.asarray(log), labels[:, None], 1).mean())

    return min(np.arange(0.6, 2.5, 0.02), key=cost)


def report(name, values, labels, temperature):
    chances = np.asarray(jax.nn.softmax(values / temperature))
    best = chances.argmax(1)
    symbols = labels < 24
    kept = symbols & (chances.max(1) >= 0.99)
    wrong = lambda rows: (best != labels)[rows].mean()
    print(
        f"{name}: glyphs right {1 - wrong(labels < REJECT):.4f}, digits and symbols {1 - wrong(symbols):.4f}; "
        f"of those with probability ≥ 0.99 ({kept.sum() / symbols.sum():.3f}) wrong {wrong(kept):.5f}; "
        f"rejected shapes {1 - wrong(labels == REJECT):.4f}"
    )
    names = CLASSES + "?"
    pairs = {}
    for a, b in zip(labels[best != labels], best[best != labels], strict=True):
        pairs[names[a] + names[b]] = pairs.get(names[a] + names[b], 0) + 1
    print("  most frequent:", sorted(pairs.items(), key=lambda p: -p[1])[:30])


def loaded(paths):
    files = [np.load(p) for p in paths]
    return tuple(np.concatenate([f[k] for f in files]) for k in ("pictures", "places", "labels"))


def main():
    reading = argparse.ArgumentParser()
    reading.add_argument("train", nargs="*")
    reading.add_argument("--calibrate", required=True)
    reading.add_argument("--test", required=True)
    reading.add_argument("--epochs", type=int, default=12)
    reading.add_argument("--seed", type=int, default=1)
    reading.add_argument("--out")
    reading.add_argument("--judge", help="weights to judge instead of training")
    asked = reading.parse_args()
    calibrate, test = loaded([asked.calibrate]), loaded([asked.test])
    if asked.judge:
        weights, temperature = stored(asked.judge)
    else:
        weights, data = quantised(train(loaded(asked.train), asked.epochs, 256, asked.seed))
        temperature = fitted_temperature(*judged(weights, calibrate))
        with open(asked.out, "wb") as file:
            file.write(struct.pack("<f", temperature) + data)
    print(f"temperature {temperature:.2f}")
    report("calibration fonts", *judged(weights, calibrate), temperature)
    report("test fonts", *judged(weights, test), temperature)


if __name__ == "__main__":
    main()
