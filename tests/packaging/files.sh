#!/usr/bin/env bash
# What a user installs, laid out in a folder of its own: the image of the Dockerfile (as far as no Docker is needed) and the package of cargo-deb
# (where that is installed). In both every shipped graph must pass `check` and a live graph start and end in order, with nothing of the sources in reach.
source "$(dirname "$0")/../interop/environment.sh"
cd "$root"
[ -n "${SKIP_BUILD:-}" ] || cargo build --release --workspace
folder=$(mktemp -d)
trap 'kill $(jobs -p) 2>/dev/null || true; wait; rm -rf "$folder"' EXIT

# works BINARY SHARE NAME: in SHARE, where config/ is.
works() {
    echo "== $3"
    # What the binary carries may not stand in for what is missing there.
    export PSEUDOFLOW_SHARE=$2
    (cd "$2" && for graph in config/graphs/*.yaml; do "$1" check "$graph" >/dev/null; done)
    (cd "$2" && exec "$1" run config/graphs/live_track.yaml --out "$folder/$3.run" --ros-args -p camera.image:=/camera/image_raw) >"$folder/$3.log" 2>&1 &
    local run=$!
    for _ in $(seq 600); do
        grep -q "bridge is ready" "$folder/$3.log" && break
        kill -0 "$run" 2>/dev/null || break
        sleep 0.1
    done
    kill -INT "$run" && wait "$run" || { cat "$folder/$3.log" >&2; return 1; }
    grep -q "bridge is ready" "$folder/$3.log" || { cat "$folder/$3.log" >&2; return 1; }
    # What debian:bookworm-slim holds by itself.
    ! ldd "$1" | grep -vE 'linux-vdso|libgcc_s\.so|libm\.so|libc\.so|ld-linux' || return 1
}

# The Dockerfile. Its build stage sees the tracked files less .dockerignore, none of which may be lacking for the lock file to hold.
git ls-files -z | grep -zvE '^(target|out)(/|$)' | xargs -0 cp --parents -t "$(mkdir -p "$folder/src" && echo "$folder/src")"
cargo metadata --locked --offline --format-version 1 --manifest-path "$folder/src/Cargo.toml" >/dev/null
stage=$(sed -n '/^FROM debian/,$p' Dockerfile)
share=$folder/image$(sed -n 's/^WORKDIR //p' <<<"$stage")
mkdir -p "$share" "$folder/image/usr/local/bin"
while read -r _ from to; do cp -r "$folder/src/$from" "$share/$to"; done < <(grep -E '^COPY [^-]' <<<"$stage")
grep -qx 'COPY --from=build /src/target/release/pseudoflow /usr/local/bin/' <<<"$stage"
cp "$target/release/pseudoflow" "$folder/image/usr/local/bin/"
"$folder/image/usr/local/bin/$(sed -n 's/^ENTRYPOINT \["\(.*\)"\]/\1/p' <<<"$stage")" $(sed -n 's/^CMD \["\(.*\)"\]/\1/p' <<<"$stage") >/dev/null
# The engine is the one that everything is measured with.
grep -qx "RUN pip install --no-cache-dir --target /engine $(grep '^onnxruntime' tests/requirements.txt)" Dockerfile
works "$folder/image/usr/local/bin/pseudoflow" "$share" docker

if cargo deb --version >/dev/null 2>&1; then
    cargo deb -p pseudoflow --no-build --strip --fast --output "$folder/pseudoflow.deb"
    dpkg-deb -x "$folder/pseudoflow.deb" "$folder/deb"
    for file in bags/tabletop_dense/metadata.yaml launch/track.launch.yaml rviz/pseudoflow.rviz; do
        [ -e "$folder/deb/usr/share/pseudoflow/$file" ] || { echo "not in the package: $file" >&2; exit 1; }
    done
    works "$folder/deb/usr/bin/pseudoflow" "$folder/deb/usr/share/pseudoflow" deb
else
    echo "passed over: no cargo-deb here (cargo install cargo-deb)"
fi
echo "ok: files"
