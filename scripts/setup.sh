# shellcheck shell=bash
# The set-up that scripts/demo, scripts/test and .ci/run share. They source this file and call set_up.
# Afterwards, lightdome is installed in .venv, an OpenCL device works, and
#
#   $root     is the folder of the clone,
#   $python   is the interpreter of .venv.
#
# It can run again at any time: whatever exists and works is left alone. It checks, in this order:
#
#   .venv     recreated if its pip does not run, or if it was moved;
#   package   reinstalled if its version or its packaging files changed;
#   device    counts once it has compiled and run a kernel (lightdome devices). If none does: PoCL from
#             its wheel (58 MB, needs no root); if that does not work or is slow here, PoCL from
#             apt-get; and if still nothing works, Intel's runtime from PyPI (280 MB, proprietary).
#
# PYTHON may name the interpreter to create .venv with; an existing .venv that works is kept.

root=$(CDPATH='' cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd -P)
venv=$root/.venv
python=$venv/bin/python
finished=$venv/.finished # written last: the clone's folder, and a checksum of the packaging files
log=$venv/setup.log      # the latest messages of pip or apt-get

say() { printf 'set-up: %s\n' "$*"; }

stop() {
    printf 'set-up: %s\n' "$*" >&2
    exit 1
}

# Stops with one line, and says where the last command's messages are.
fail() {
    [ ! -s "$log" ] || stop "$1 (its messages: $log)"
    stop "$1"
}

set_up() {
    # Drop settings that would lead Python or pip away from .venv, and provide a home for caches.
    unset PYTHONHOME PYTHONPATH PIP_TARGET PIP_PREFIX
    export PIP_USER=0 PIP_NO_INPUT=1 PIP_DISABLE_PIP_VERSION_CHECK=1
    if [ ! -w "${HOME:-/nonexistent}" ]; then
        export HOME=$venv/home XDG_CACHE_HOME=$venv/home/.cache MPLCONFIGDIR=$venv/home/matplotlib
    fi
    [ -w "$root" ] || stop "cannot write into $root"
    make_venv
    install_package
    find_device
    say "Python $(python_facts "$python"), OpenCL device: $device"
    [ -z "$slow" ] || say "$slow"
}

# --- .venv -----------------------------------------------------------------------------------------

# A .venv that the user made has no such mark: keep it, and install the package there.
make_venv() {
    if "$python" -m pip --version >/dev/null 2>&1; then
        [ -e "$finished" ] || return 0
        grep -qxF "clone $root" "$finished" && return 0
    fi
    choose_python
    say "creating .venv with Python $base_version"
    rm -rf -- "$venv"
    mkdir "$venv"
    if ! "$base_python" -c 'import ensurepip' 2>/dev/null; then
        local package=python${base_version%.*}-venv
        say "installing $package, which Python $base_version needs to create environments"
        system_install "$package" || fail "$base_python lacks the module ensurepip; $(advice "$package")"
    fi
    "$base_python" -m venv "$venv" >"$log" 2>&1 || fail "Python $base_version could not create .venv"
}

# Prints the version of the Python $1. Fails unless it is 3.10 or newer.
python_facts() {
    "$1" -c '
import sys
if sys.version_info < (3, 10):
    sys.exit(1)
print("%d.%d.%d" % sys.version_info[:3])' 2>/dev/null
}

# Sets base_python and base_version. A name on PATH proves nothing: pyenv leaves names that only fail.
choose_python() {
    for base_python in "${PYTHON:-python3}" python3.{14,13,12,11,10}; do
        base_version=$(python_facts "$base_python") && return 0
        [ -z "${PYTHON:-}" ] || stop "PYTHON=$PYTHON is not a working Python 3.10 or newer"
    done
    stop "found no Python 3.10 or newer; install one, or name it: PYTHON=/path/to/python3"
}

# --- the package -----------------------------------------------------------------------------------

install_package() {
    local wanted
    wanted=$(
        printf 'clone %s\n' "$root"
        {
            cat -- "$root/setup.cfg" "$root/setup.py" "$root/pyproject.toml"
            grep '^__version__' "$root/pyhost/__init__.py"
        } | cksum
    )
    [ -e "$finished" ] && [ "$(cat "$finished")" = "$wanted" ] && return 0
    rm -f "$finished"
    say "installing lightdome and its dependencies into .venv (under a minute)"
    if ! (cd "$root" && pip install --editable '.[test]'); then
        fail "pip could not install lightdome (is there a network?): $(sed -n 's/^ *ERROR: //p' "$log" | tail -n 1)"
    fi
    printf '%s\n' "$wanted" >"$finished"
}

pip() { "$python" -m pip --quiet "$@" >"$log" 2>&1 </dev/null; }

# --- the device ------------------------------------------------------------------------------------

# Sets device to the name of an OpenCL device that works, or stops.
find_device() {
    device_works && return 0
    [ -z "${PYOPENCL_CTX:-}" ] || stop "PYOPENCL_CTX=$PYOPENCL_CTX: $(sed -n '$s/^lightdome devices: //; $p' "$log")"
    pocl_from_wheel && [ -z "$slow" ] && return 0
    say "${device:+a faster OpenCL device: }trying the system package pocl-opencl-icd"
    system_install pocl-opencl-icd && device_works && return 0
    [ -n "$device" ] || intel_from_pypi || fail "no OpenCL device works; $(advice pocl-opencl-icd)"
}

# Sets device, and sets slow to the remark on a device that is slow for its machine, if there is one.
device_works() {
    local said
    device='' slow=''
    said=$("$python" -m lightdome devices 2>"$log" </dev/null) && [ -n "$said" ] || return 1
    device=${said%%$'\n'*}
    slow=$(sed -n 's/^note: //p' <<<"$said")
}

# On processors newer than its LLVM 14, the wheel lists a device that fails or crashes.
pocl_from_wheel() {
    say "no OpenCL device works yet; trying PoCL's wheel (58 MB)"
    pip install pocl-binary-distribution || return 1
    device_works && return 0
    say "the wheel does not work here; removing it"
    pip uninstall --yes pocl-binary-distribution || true
    return 1
}

# Needs no root, and supports processors that the wheel does not; the licence is Intel's own.
intel_from_pypi() {
    say "no OpenCL device works yet; trying Intel's runtime from PyPI (280 MB, under Intel's own licence)"
    pip install intel-opencl-rt intel-cmplr-lib-rt || return 1
    # pyopencl's loader also searches its own folder, where no other program looks.
    local vendors
    vendors=$("$python" -c 'import pathlib, pyopencl; print(pathlib.Path(pyopencl.__file__).parent / ".libs")' 2>"$log")
    printf '%s\n' "$venv/lib/libintelocl.so" >"$vendors/intel.icd" && device_works
}

# --- the system's packages -------------------------------------------------------------------------

# Installs the package $1 with apt-get, if that needs no password.
system_install() {
    command -v apt-get >/dev/null || return 1
    local as_root=()
    if [ "$(id -u)" != 0 ]; then
        sudo -n true 2>/dev/null || return 1
        as_root=(sudo -n)
    fi
    # The existing package lists may be too old to find the package.
    "${as_root[@]}" apt-get --quiet update >"$log" 2>&1 </dev/null || true
    "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get --quiet --yes --no-install-recommends install "$1" \
        >>"$log" 2>&1 </dev/null
}

# How to install the Debian package $1.
advice() {
    if command -v apt-get >/dev/null; then
        echo "run: sudo apt-get update && sudo apt-get install $1"
    else
        echo "install $1, whatever its name here, with your system's package manager"
    fi
}
