#!/usr/bin/env bash
# Builds the robot's firmware with Zephyr for both boards, and checks what can be checked without one.
#
#   build.sh FOLDER       FOLDER was made by 'frogkick firmware build --out FOLDER'; run it in the folder of 'west update'
#   build.sh --check ELF  only how much of the program's partition and of RAM an image takes
#
# Images go to build/BOARD. Exit code 2: nothing was built, or an image that must not be flashed.
set -euo pipefail

HERE="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
BOARDS=(nrf52dk/nrf52832 bl652_dvk)
RAM_BEGIN=$((0x20000000))
RAM_BYTES=$((64 * 1024))
RAM_LEFT_LEAST=$((8 * 1024)) # with Zephyr 3.7, for what is added one day; 4.x takes more itself, and has to fit

refuse() {
    echo "build.sh: $*" >&2
    exit 2
}

check() { # check NAME ELF: that an image keeps to its partition, and how much RAM it leaves
    local name="$1" elf="$2" readelf="${READELF:-readelf}"
    local segments begin size type virtual physical file_bytes memory_bytes
    local flash_begin=$((1 << 32)) flash_end=0 ram_end=$RAM_BEGIN
    [[ -f "$elf" ]] || refuse "$elf is not there: nothing was linked"
    segments="$("$readelf" -hlW "$elf" 2>/dev/null)" || refuse "$elf is no ELF that $readelf can read"
    [[ "$segments" =~ Machine:\ +ARM ]] || refuse "$elf is not for this chip"
    # The program's partition, as frogkick.dtsi cuts the flash.
    read -r begin size < <(sed -n '/app_partition: /,/}/s/.*reg = <\(0x[0-9a-f]*\) \(0x[0-9a-f]*\)>.*/\1 \2/p' "$HERE/frogkick.dtsi") ||
        refuse "frogkick.dtsi has no app_partition with a reg of two numbers"
    while read -r type _ virtual physical file_bytes memory_bytes _; do
        [[ "$type" == LOAD ]] || continue
        if ((file_bytes > 0)); then # what is written to flash: code, constants, first values of data
            flash_begin=$((physical < flash_begin ? physical : flash_begin))
            flash_end=$((physical + file_bytes > flash_end ? physical + file_bytes : flash_end))
        fi
        if ((virtual >= RAM_BEGIN)); then
            ram_end=$((virtual + memory_bytes > ram_end ? virtual + memory_bytes : ram_end))
        fi
    done <<<"$segments"
    ((flash_end > 0)) || refuse "$elf loads nothing: it is no image of a firmware"
    local used=$((ram_end - RAM_BEGIN)) left=$((RAM_BEGIN + RAM_BYTES - ram_end))
    echo "$name: flash $((flash_end - begin)) of $((size)) bytes, RAM $used of $RAM_BYTES bytes, $left left"
    ((flash_begin >= begin && flash_end <= begin + size)) ||
        refuse "$name: the image takes flash from $flash_begin to $flash_end, and its partition is $((begin)) to $((begin + size)):" \
            "it would lie over the tables. Build in a smaller table, or change the partitions in frogkick.dtsi"
    ((left >= RAM_LEFT_LEAST)) ||
        refuse "$name: $left bytes of RAM are left, and $RAM_LEFT_LEAST are asked for: lower CONFIG_FROGKICK_LOG_BYTES"
}

versions() { # that Zephyr and nrfx are what the sources are written for
    local zephyr hal major minor patch nrfx
    zephyr="${ZEPHYR_BASE:-$(west list -f '{abspath}' zephyr 2>/dev/null)}" || true
    [[ -f "$zephyr/VERSION" ]] || refuse "no Zephyr here: run it where 'west update' was run, or set ZEPHYR_BASE"
    major="$(sed -n 's/^VERSION_MAJOR = *//p' "$zephyr/VERSION")"
    minor="$(sed -n 's/^VERSION_MINOR = *//p' "$zephyr/VERSION")"
    patch="$(sed -n 's/^PATCHLEVEL = *//p' "$zephyr/VERSION")"
    [[ "$major.$minor" =~ ^(3\.7|4\.[0-3])$ ]] ||
        refuse "Zephyr is $major.$minor.$patch, and the firmware is written for 3.7 to 4.3: west.yml names the release"
    hal="$(west list -f '{abspath}' hal_nordic 2>/dev/null)" || true
    nrfx="$(sed -n 's/^## \[\([0-9.]*\)\].*/\1/p' "$hal/nrfx/CHANGELOG.md" 2>/dev/null | head -n 1)" || true
    # Where its list of changes is not there, limbs.c refuses another than 3 by itself.
    [[ -z "$nrfx" || "$nrfx" == 3.* ]] ||
        refuse "nrfx is $nrfx, and limbs.c is written for nrfx 3: take the one that Zephyr's own manifest names"
    echo "Zephyr $major.$minor.$patch in $zephyr, nrfx ${nrfx:-of unknown version}"
    [[ "$major" == 3 ]] || RAM_LEFT_LEAST=0
    [[ "$major.$minor" =~ ^(3\.7|4\.3)$ ]] || echo "note: of releases only 3.7 and 4.3 were looked at"
}

configured() { # configured NAME FOLDER: what the check of the image relies on, and what a person should know
    grep -qx 'CONFIG_USE_DT_CODE_PARTITION=y' "$2/zephyr/.config" ||
        refuse "$1: CONFIG_USE_DT_CODE_PARTITION is off, so the linker would let an image lie over the tables"
    if grep -qx 'CONFIG_CLOCK_CONTROL_NRF_K32SRC_RC=y' "$2/zephyr/.config"; then
        echo "note: $1 takes its time from the RC oscillator: 5 s may be 0.1 s shorter until it is calibrated. With a crystal" \
            "of 32.768 kHz on the board, set CONFIG_CLOCK_CONTROL_NRF_K32SRC_XTAL=y"
    fi
}

if [[ $# == 2 && "$1" == --check ]]; then
    check "$2" "$2"
    exit
fi
[[ $# == 1 && "$1" != -* ]] || refuse "usage: build.sh FOLDER, or build.sh --check ELF"
[[ -f "$1/emitted/fk_table.c" ]] || refuse "$1 was not made by 'frogkick firmware build --tables x.fkt --out $1'"
made="$(cd "$1" && pwd)"
command -v west >/dev/null || refuse "no west here: install Zephyr's tools first"
versions
for board in "${BOARDS[@]}"; do
    folder="build/${board%%/*}"
    west build -p always -d "$folder" -b "$board" "$HERE" -- -DFROGKICK_BUILD="$made" || refuse "$board does not build"
    configured "$board" "$folder"
    check "$board" "$folder/zephyr/zephyr.elf"
done
echo "built and checked, not flashed: 'west flash -d build/BOARD', then switch the robot off and on to pair"
