# shellcheck shell=bash
# The set-up that scripts/demo, scripts/test and .ci/run share. They source it and call set_up:
# then lightdome is installed in .venv, an OpenCL device works, and
#
#   $root     is the folder of the clone,
#   $python   is the interpreter of .venv.
#
# It may run again at any time: what is there and works stays as it is. What it looks at, in this order:
#
#   .venv     is made anew if it is unfinished, was moved, or its Python changed;
#   package   is installed again if what describes it changed, or its version;
#   device    counts once it has compiled and run a kernel (lightdome.probe). If none does: PoCL from
#             its wheel (58 MB, needs no root); if that does not work or is slow here, PoCL from the
#             system's packages; and if still nothing works, Intel's runtime from PyPI (280 MB, proprietary).
#
# PYTHON may name the interpreter that .venv is to be made with.

root=$(CDPATH='' cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd -P)
venv=$root/.venv
python=$venv/bin/python
finished=$venv/.finished     # written last: which Python, where, and the hash of what was installed
unfinished=$venv/.unfinished # there while .venv is being made
log=$venv/setup.log          # what pip and apt-get said last

say() { printf 'set-up: %s\n' "$*"; }

stop() {
    printf 'set-up: %s\n' "$*" >&2
    exit 1
}

set_up() {
    clean_environment
    lock
    make_venv
    install_package
    find_device
    unlock
    say "Python $(sed -n 's/^python //p' "$finished"), OpenCL device: $device"
    [ -z "$slow" ] || say "$slow"
}

# Settings of the caller's that would lead Python or pip away from .venv, and a home for caches.
clean_environment() {
    unset PYTHONHOME PYTHONPATH PIP_TARGET PIP_PREFIX PIP_REQUIRE_VIRTUALENV
    export PIP_USER=0 PIP_NO_INPUT=1 PIP_DISABLE_PIP_VERSION_CHECK=1
    if [ ! -w "${HOME:-/nonexistent}" ]; then
        export HOME=$venv/home XDG_CACHE_HOME=$venv/home/.cache MPLCONFIGDIR=$venv/home/matplotlib
    fi
    [ -w "${TMPDIR:-/nonexistent}" ] || unset TMPDIR
}

# One set-up of a clone at a time, where there is flock. The lock is this file, held as descriptor 9.
lock() {
    command -v flock >/dev/null || return 0
    exec 9<"$root/scripts/setup.sh"
    flock -n 9 && return 0
    say "waiting for another set-up of this clone"
    flock 9 || say "cannot lock here; going on without"
}

unlock() { exec 9<&-; }

# --- .venv -----------------------------------------------------------------------------------------

make_venv() {
    [ -w "$root" ] || stop "cannot write into $root"
    venv_is_sound && return 0
    choose_python
    say "making .venv with Python $base_version"
    rm -rf -- "$venv"
    mkdir -p "$venv"
    : >"$unfinished"
    "$base_python" -m venv "$venv" >"$log" 2>&1 || fail "Python $base_version could not make .venv"
}

# Whether .venv has been made to its end, here, with the Python that is asked for, and still runs.
# A .venv without either mark is the user's own: it stays, and gets the package.
venv_is_sound() {
    [ -x "$python" ] && [ ! -e "$unfinished" ] || return 1
    local is_now
    is_now=$(python_facts "$python") || return 1
    if [ -e "$finished" ]; then
        [ "$(sed -n 1,2p "$finished")" = "$(facts_to_keep "$is_now")" ] || return 1
    else
        "$python" -m pip --version >/dev/null 2>&1 || return 1
    fi
    [ -z "${PYTHON:-}" ] || [ "$(sed -n 1p <<<"$is_now")" = "$(python_facts "$PYTHON" | sed -n 1p)" ]
}

facts_to_keep() { printf 'python %s\nclone %s\n' "$(sed -n 1p <<<"$1")" "$root"; }

# Prints the version of the Python $1, and the interpreter that an environment is made with (not that
# of another environment, which may go away). Fails unless it is 3.10 or newer.
python_facts() {
    "$1" -c '
import sys
if sys.version_info < (3, 10):
    sys.exit(1)
print("%d.%d.%d" % sys.version_info[:3])
print(getattr(sys, "_base_executable", None) or sys.executable)' 2>/dev/null
}

has_venv() { "$1" -c 'import ensurepip, venv' 2>/dev/null; }

# Sets base_python and base_version. A name on PATH proves nothing (pyenv leaves names behind that
# only fail), so each is run; one that can make environments goes before one that first needs a package.
choose_python() {
    local name facts found without=''
    for name in ${PYTHON:+"$PYTHON"} python3 python python3.{14,13,12,11,10}; do
        facts=$(python_facts "$name") || facts=''
        if [ -n "${PYTHON:-}" ] && [ -z "$facts" ]; then
            stop "PYTHON=$PYTHON is not a Python 3.10 or newer that runs"
        fi
        [ -n "$facts" ] || continue
        found=$(sed -n 2p <<<"$facts")
        base_version=$(sed -n 1p <<<"$facts")
        if has_venv "$found"; then
            base_python=$found
            return 0
        fi
        without=${without:-$found}
        [ -z "${PYTHON:-}" ] || break
    done
    [ -n "$without" ] || stop "found no Python 3.10 or newer; install one, or name it: PYTHON=/path/to/python3"
    base_python=$without
    base_version=$(python_facts "$without" | sed -n 1p)
    local package=python${base_version%.*}-venv
    say "installing $package, since Python $base_version cannot make environments without it"
    mkdir -p "$venv" # for the log
    : >"$unfinished"
    system_install "$package" || fail "$base_python lacks the module ensurepip; $(advice "$package")"
    has_venv "$base_python" || stop "$package is installed, but $base_python still lacks the module ensurepip"
}

# --- the package -----------------------------------------------------------------------------------

install_package() {
    local wanted
    wanted=$(
        facts_to_keep "$(python_facts "$python")"
        {
            cat -- "$root/setup.cfg" "$root/setup.py" "$root/pyproject.toml"
            grep '^__version__' "$root/pyhost/__init__.py"
        } | cksum
    )
    [ -e "$finished" ] && [ "$(cat "$finished")" = "$wanted" ] && return 0
    rm -f "$finished"
    say "installing lightdome and the packages that it needs into .venv (under a minute)"
    (cd "$root" && pip install --editable '.[test]') || fail_pip "pip could not install lightdome"
    printf '%s\n' "$wanted" >"$finished"
    rm -f "$unfinished"
}

pip() { "$python" -m pip --quiet "$@" >"$log" 2>&1 </dev/null; }

# --- the device ------------------------------------------------------------------------------------

# Sets device, the name of the OpenCL device that works, or stops.
find_device() {
    device_works && return 0
    if [ -n "${PYOPENCL_CTX:-}" ]; then
        stop "PYOPENCL_CTX=$PYOPENCL_CTX: $(sed -n '$s/^probe: //; $p' "$log")"
    fi
    # No device, or is something missing that the probe needs?
    if ! "$python" -c 'import lightdome, matplotlib, numpy, OpenImageIO, pyopencl, pytest' >/dev/null 2>&1; then
        say ".venv is damaged"
        rm -f "$finished"
        : >"$unfinished"
        make_venv
        install_package
        device_works && return 0
    fi
    pocl_from_wheel && return 0
    pocl_from_system && return 0
    [ -n "$device" ] || intel_from_pypi || fail "no OpenCL device works; $(advice pocl-opencl-icd)"
}

# Sets device, and slow to what the probe says of a device that is slow for its machine.
device_works() {
    local said
    device='' slow=''
    said=$("$python" -m lightdome.probe 2>"$log" </dev/null) && [ -n "$said" ] || return 1
    device=${said%%$'\n'*}
    slow=$(sed -n 's/^note: //p' <<<"$said")
}

# The wheel knows no processor newer than its LLVM 14: there it lists a device that fails or crashes.
pocl_from_wheel() {
    [ "$(uname -sm)" = 'Linux x86_64' ] || return 1
    say "no OpenCL device works yet; trying PoCL's wheel (58 MB)"
    if ! pip install pocl-binary-distribution; then
        say "pip could not install the wheel"
        return 1
    fi
    if device_works; then
        [ -n "$slow" ] || return 0
        say "the wheel works, but is slow here"
        return 1
    fi
    say "the wheel does not work here; removing it"
    pip uninstall --yes pocl-binary-distribution || true
    return 1
}

pocl_from_system() {
    say "${device:+a faster OpenCL device: }trying the system's package pocl-opencl-icd"
    system_install pocl-opencl-icd || return 1
    device_works && return 0
    stop "pocl-opencl-icd is installed, but its device does not work${OCL_ICD_VENDORS:+ (OCL_ICD_VENDORS=$OCL_ICD_VENDORS hides it?)}; see: $python -m lightdome.probe 0 0"
}

# Needs no root, and knows processors that the wheel does not; its licence is Intel's own.
intel_from_pypi() {
    [ "$(uname -sm)" = 'Linux x86_64' ] || return 1
    say "no OpenCL device works yet; trying Intel's runtime from PyPI (280 MB, under Intel's own licence)"
    pip install intel-opencl-rt intel-cmplr-lib-rt || return 1
    # pyopencl's loader looks beside itself too, where nobody else looks.
    local vendors
    vendors=$("$python" -c 'import pathlib, pyopencl; print(pathlib.Path(pyopencl.__file__).parent / ".libs")' 2>"$log")
    printf '%s\n' "$venv/lib/libintelocl.so" >"$vendors/intel.icd" && device_works
}

# --- the system's packages -------------------------------------------------------------------------

# Installs the package $1 with apt-get, where that goes without asking anybody.
system_install() {
    : >"$log"
    command -v apt-get >/dev/null || return 1
    local as_root=''
    if [ "$(id -u)" != 0 ]; then
        sudo -n true 2>/dev/null || return 1
        as_root='sudo -n'
    fi
    ls /var/lib/apt/lists/*_Packages* >/dev/null 2>&1 || apt_get update || true
    # Lists that are there may be too old to find the package's file with.
    apt_get install "$1" || { apt_get update && apt_get install "$1"; }
}

apt_get() {
    # shellcheck disable=SC2086 # as_root is empty or two words
    $as_root env DEBIAN_FRONTEND=noninteractive apt-get --quiet --yes --no-install-recommends \
        -o DPkg::Lock::Timeout=300 "$@" >>"$log" 2>&1 </dev/null
}

# The command that installs the Debian package $1, or what it is called elsewhere.
advice() {
    local name=$1 command
    if command -v apt-get >/dev/null; then
        echo "run: sudo apt-get update && sudo apt-get install $name"
        return
    fi
    [ "$name" != pocl-opencl-icd ] || name=pocl
    for command in 'dnf install' 'zypper install' 'pacman -S' 'apk add'; do
        if command -v "${command%% *}" >/dev/null; then
            echo "run: sudo $command $name"
            return
        fi
    done
    if command -v brew >/dev/null; then
        echo "run: brew install $name"
    else
        echo "install $name with your system's package manager"
    fi
}

# --- failing ---------------------------------------------------------------------------------------

# Stops with one line, and where to find what the last command said.
fail() {
    [ ! -s "$log" ] || stop "$1 (its messages: $log)"
    stop "$1"
}

# How pip's many versions tell that they reached no index. The last: every index has setuptools for every Python.
no_index='Retrying \(|Max retries|Connection(Error|Timeout)|ConnectTimeout|NameResolution|name resolution|ProxyError'
no_index+='|Could not fetch URL|setuptools.*\(from versions: none\)'

fail_pip() {
    local reason
    reason=$(sed -n 's/^ *ERROR: //p' "$log" | tail -n 1)
    if grep -qE "$no_index" "$log"; then
        reason="it reached no package index; is there a network?"
    fi
    fail "$1: ${reason:-no reason given}"
}
