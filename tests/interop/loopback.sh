#!/usr/bin/env bash
# With ROS_LOCALHOST_ONLY=1 another host's datagrams are refused by the kernel; without, they get in. The other host is a network namespace.
# Needs: ip (iproute2) and user namespaces; says so and passes over where there are none.
source "$(dirname "$0")/environment.sh"
cd "$root"
[ -n "${SKIP_BUILD:-}" ] || cargo build --release --workspace
if [ "${1:-}" != inside ]; then
    if ! command -v ip >/dev/null || ! unshare -rn ip link add v0 type veth peer name v1 2>/dev/null; then
        echo "passed over: no ip, no user namespaces or no veth here"
        exit 0
    fi
    SKIP_BUILD=1 ROS_DOMAIN_ID=0 exec unshare -rn bash "$0" inside
fi

out=$(mktemp -d)
trap 'kill $(jobs -p) 2>/dev/null || true; wait; rm -rf "$out"' EXIT
ip link set lo up
unshare -n sleep 600 &
far=$!
# Its namespace first: a link that is made before `unshare` has made that would end in this one.
until [ "$(readlink /proc/$far/ns/net)" != "$(readlink /proc/self/ns/net)" ]; do sleep 0.1; done
ip link add v0 type veth peer name v1 netns "$far"
ip addr add 10.9.0.1/24 dev v0
ip link set v0 up
nsenter -t "$far" -n sh -c 'ip link set lo up; ip addr add 10.9.0.2/24 dev v1; ip link set v1 up'

# Whether datagrams from the other host to the ports of domain 0's first participant are refused: 1 or 0 for each.
# The first refusal is enough: the kernel answers a host about once a second after its first six, so that further ones for one port would leave none for the next.
knock() {
    nsenter -t "$far" -n "$python" - <<'PY'
import socket, time
for port in (7410, 7411):
    caller = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    caller.connect(("10.9.0.1", port))
    refused = 0
    for _ in range(20):
        try:
            caller.send(b"hello")
        except ConnectionRefusedError:
            refused = 1
            break
        time.sleep(0.05)
    print(refused, end=" ")
PY
}

for only in 1 0; do
    ROS_LOCALHOST_ONLY=$only "$target/release/pseudoflow" run tests/interop/camera.yaml --out "$out/$only" \
        --set recorder.path="$out/bag_$only" >"$out/$only.log" 2>&1 &
    run=$!
    # Ready: its sockets are as they stay.
    until grep -q "bridge is ready" "$out/$only.log"; do
        kill -0 "$run" || { cat "$out/$only.log" >&2; exit 1; }
        sleep 0.1
    done
    got=$(knock)
    echo "ROS_LOCALHOST_ONLY=$only: refused $got"
    [ "$got" = "$only $only " ] || { cat "$out/$only.log" >&2; exit 1; }
    kill -INT "$run"
    wait "$run" || { cat "$out/$only.log" >&2; exit 1; }
done
echo "ok: loopback"
