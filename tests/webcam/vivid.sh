#!/bin/sh
# The webcam driver on a real /dev/video0: the kernel's test camera, vivid, in a small virtual machine.
#
#   sudo apt-get install --no-install-recommends qemu-system-x86 && tests/webcam/vivid.sh
#
# It takes Debian's kernel and busybox from their packages without installing them, shows the guest this
# machine's own / read-only over 9p, and runs tests/webcam/vivid_guest.py there.
# PYTHON names the interpreter (default: .venv/bin/python), WORK where the packages are kept, ACCELERATOR=kvm
# makes it quicker where that works.
set -eu

here=$(cd "$(dirname "$0")" && pwd)
python=${PYTHON:-$here/../../.venv/bin/python}
work=${WORK:-${TMPDIR:-/tmp}/rtagent-vivid}
mkdir -p "$work/packages" "$work/kernel"

command -v qemu-system-x86_64 >/dev/null || {
    echo "there is no qemu-system-x86_64: sudo apt-get install --no-install-recommends qemu-system-x86" >&2
    exit 2
}

fetch() {
    image=$(apt-cache depends linux-image-amd64 | awk '/Depends: linux-image/ {print $2; exit}')
    (cd "$work/packages" && apt-get download -q "$image" busybox-static)
    for package in "$work"/packages/*.deb; do dpkg-deb -x "$package" "$work/kernel"; done
}
[ -e "$work/kernel/bin/busybox" ] || fetch

busybox=$work/kernel/bin/busybox
release=$(ls "$work/kernel/lib/modules" | tail -1)
depmod=$(command -v depmod || echo "$busybox depmod")
$depmod -b "$work/kernel" "$release"

# The first root: busybox, and what the kernel needs to see the disk of 9p and the camera
rm -rf "$work/root"
mkdir -p "$work/root/bin" "$work/root/host" "$work/root/lib/modules/$release"
cp "$busybox" "$work/root/bin/"
modules=$work/kernel/lib/modules/$release
cp "$modules"/modules.dep* "$modules"/modules.alias* "$modules"/modules.symbols* "$modules"/modules.builtin \
    "$work/root/lib/modules/$release/"
needed() {
    for name in virtio_pci 9pnet_virtio 9p vivid; do
        grep -E "/$name\.ko:" "$modules/modules.dep" | tr -d ':' | tr ' ' '\n'
    done | sort -u
}
needed | while read -r module; do
    mkdir -p "$work/root/lib/modules/$release/$(dirname "$module")"
    cp "$modules/$module" "$work/root/lib/modules/$release/$module"
done
cat >"$work/root/init" <<EOF
#!/bin/busybox sh
/bin/busybox mkdir -p /proc /sys /dev /host
/bin/busybox mount -t proc proc /proc
/bin/busybox mount -t devtmpfs dev /dev
for name in virtio_pci 9pnet_virtio 9p; do /bin/busybox modprobe \$name; done
/bin/busybox modprobe vivid n_devs=1 node_types=0x1
/bin/busybox mount -t 9p -o trans=virtio,version=9p2000.L,cache=loose,msize=1048576,ro host /host
/bin/busybox mount -t proc proc /host/proc
/bin/busybox mount -t sysfs sys /host/sys
/bin/busybox mount -o bind /dev /host/dev
/bin/busybox mount -t tmpfs tmp /host/tmp
HOME=/tmp PATH=/usr/bin:/bin PYTHONDONTWRITEBYTECODE=1 OPENCV_LOG_LEVEL=ERROR \
    /bin/busybox chroot /host $python -u $here/vivid_guest.py </dev/null
echo "exit code \$?"
/bin/busybox poweroff -f
EOF
chmod +x "$work/root/init"
(cd "$work/root" && "$busybox" find . | "$busybox" cpio -o -H newc 2>/dev/null | gzip -1) >"$work/root.cpio.gz"

qemu-system-x86_64 -accel "${ACCELERATOR:-tcg}" -cpu max -smp 2 -m 2048 -nodefaults -no-reboot -display none \
    -kernel "$work/kernel/boot/vmlinuz-$release" -initrd "$work/root.cpio.gz" \
    -append "console=ttyS0 quiet loglevel=3 panic=-1 mitigations=off" -serial stdio \
    -virtfs local,path=/,mount_tag=host,security_model=none,readonly=on,multidevs=remap |
    tee "$work/output"
grep -q "^exit code 0" "$work/output"
