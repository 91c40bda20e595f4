# Sourced by the interop tests: DDS on 127.0.0.1 alone, without multicast, in a domain of its own.
set -euo pipefail
interop=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
root=$(cd "$interop/../.." && pwd)
python=${PYTHON:-python3}
target=${CARGO_TARGET_DIR:-$root/target}

# 0 to 99: two tests at a time rarely meet, and all ports lie below those that Linux hands out.
export ROS_DOMAIN_ID=${ROS_DOMAIN_ID:-$(($$ % 100))}
export ROS_LOCALHOST_ONLY=1
unset ROS_AUTOMATIC_DISCOVERY_RANGE ROS_STATIC_PEERS
export CYCLONEDDS_URI='<CycloneDDS><Domain>
  <General><Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces><AllowMulticast>false</AllowMulticast></General>
  <Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>11</MaxAutoParticipantIndex>
    <Peers><Peer address="127.0.0.1"/></Peers></Discovery>
</Domain></CycloneDDS>'

if [ -z "${SKIP_BUILD:-}" ]; then
    # The whole workspace, whose features the scripts' own builds have too: `-p` would build what is below it once more.
    cargo build --release --manifest-path "$root/Cargo.toml" --workspace --bins --example publish_poses --example receive_images
fi
publish_poses=$target/release/examples/publish_poses
receive_images=$target/release/examples/receive_images

# Ends what the test started when the test ends early.
children=()
trap '[ ${#children[@]} -eq 0 ] || kill "${children[@]}" 2>/dev/null || true' EXIT

# both NAME COMMAND... -- COMMAND...: runs two programs side by side; fails unless both end in 0.
both() {
    local name=$1 first=() second=() status=0
    shift
    while [ "$1" != -- ]; do first+=("$1") && shift; done
    shift
    second=("$@")
    echo "== $name"
    timeout 150 "${first[@]}" &
    local one=$!
    children+=("$one")
    sleep "${HEAD_START:-0}"
    timeout 150 "${second[@]}" &
    local two=$!
    children+=("$two")
    wait "$one" || status=$?
    wait "$two" || status=$?
    children=()
    if [ "$status" -ne 0 ]; then
        echo "FAILED: $name (exit $status)" >&2
        return 1
    fi
}
