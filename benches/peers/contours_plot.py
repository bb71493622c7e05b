"""Plots bias and RMSE of the contour filters, relative to the Kanatani-Cramer-Rao bound.

The input is the table printed by the example `contour_accuracy`.

    cargo run --release -p planish-contour --example contour_accuracy 300 radius > accuracy.csv
    python benches/peers/contours_plot.py docs/images/contour_accuracy.svg accuracy.csv [more.csv]
"""

import csv
import sys

import matplotlib

matplotlib.use("svg")
import matplotlib.pyplot as plt

matplotlib.rcParams["svg.hashsalt"] = "planish"
matplotlib.rcParams["svg.fonttype"] = "none"
METHODS = {
    "ekf": ("EKF", "tab:red", "o"),
    "iekf": ("IEKF", "tab:orange", "x"),
    "batch-uncorrected": ("batch, bias not corrected (ODR)", "tab:gray", "s"),
    "batch": ("batch", "tab:blue", "D"),
    "nuiekf": ("NUIEKF", "tab:green", "^"),
    "batch-margin": ("batch, corner margin 2 σ", "tab:cyan", "v"),
    "nuiekf-margin": ("NUIEKF, corner margin 2 σ", "tab:olive", "v"),
}


def main():
    rows = []
    for path in sys.argv[2:]:
        with open(path, newline="") as file:
            rows += [row for row in csv.DictReader(file) if not row["kind"].startswith("#")]
    kinds = list(dict.fromkeys(row["kind"] for row in rows))
    figure, axes = plt.subplots(2, len(kinds), figsize=(3 * len(kinds), 5.2), sharex=True, sharey="row", squeeze=False)
    for column, kind in enumerate(kinds):
        for method, (label, colour, marker) in METHODS.items():
            mine = sorted((int(r["readings"]), r) for r in rows if r["kind"] == kind and r["method"] == method)
            if not mine:
                continue
            n = [number for number, _ in mine]
            for axis, key in zip(axes[:, column], ("bias_over_kcr", "rmse_over_kcr")):
                axis.plot(n, [float(r[key]) for _, r in mine], marker=marker, ms=4, lw=1, color=colour, label=label)
        axes[0, column].set_title(kind)
        axes[1, column].set_xlabel("readings")
        axes[1, column].axhline(1.05, color="black", lw=0.6, ls=":")
        axes[1, column].set_yscale("log")
        axes[1, column].set_yticks([1, 1.05, 1.2, 1.5, 2, 2.5], ["1", "1.05", "1.2", "1.5", "2", "2.5"])
        axes[1, column].minorticks_off()
        axes[0, column].set_xscale("log")
        axes[0, column].set_xticks([50, 200, 2000], ["50", "200", "2000"])
    axes[0, 0].set_ylabel("largest bias / σ of the bound")
    axes[1, 0].set_ylabel("RMSE / bound")
    handles = {label: handle for axis in axes[0] for handle, label in zip(*axis.get_legend_handles_labels())}
    figure.legend(handles.values(), handles.keys(), loc="lower center", ncol=4, fontsize=8, frameon=False)
    figure.tight_layout(rect=(0, 0.09, 1, 1))
    figure.savefig(sys.argv[1], metadata={"Date": None})


if __name__ == "__main__":
    main()
