# Short names for what is typed often. `just check` is what lands a change.

check:
    .ci/run

# The heavy statistics: two hundred seeded draws of each kind.
nightly:
    cargo test --release --workspace -- --ignored --nocapture

docs:
    cargo doc --workspace --no-deps

# Damaged files for every reader and for commands; the checks run two thousand for each reader.
fuzz:
    cargo run --release -p planish-fuzz -- --cases 1000000

# Inputs that reach new code become parents of further inputs: seconds for each reader and command.
fuzz-coverage SECONDS="600":
    fuzz/coverage/run {{SECONDS}}

# Licences, sources and versions of dependencies, and known defects of them.
deny:
    cargo deny check

bench:
    cargo bench -p planish-estimate
