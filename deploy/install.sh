#!/bin/sh
# Installs a line's systemd units on this host: install.sh [OPTIONS] LINE.toml
#
#   --roles LIST     what runs here, comma-separated; default: router,aggregator,camera,segmenter,regressor,
#                    and encoder, gnss, alarms and viewer where LINE.toml has [encoder] (it needs a live camera), [gnss],
#                    [alarms], [viewer]. also: recorder, metrics, page. camera=front,camera=rear: those cameras only.
#                    loader: no unit, the certificate that `tuberline load` and the page need to change loads.
#   --page-token FILE  who has the token in FILE (16 characters and more) gives orders on the page
#   --certs DIR      copy the certificates that these roles need from DIR (made by `tuberline certs make`)
#   --run ID         id of the run, the same on every host of the line; default: kept, or the time of now
#   --program FILE   from now on run this tuberline, of a version installed beside the other; the line is started again
#   --replace        take the new LINE.toml although another one is installed
#   --no-start       enable the line, start nothing
#   --uninstall      stop all lines and take the units away; configs, certificates, ledgers and recordings stay
#
# Says what it did, one line each; run again it changes nothing ("kept"). DESTDIR installs into a folder and touches
# neither users nor systemd; TUBERLINE names the program.
set -eu

here=$(cd "$(dirname "$0")" && pwd)
destdir=${DESTDIR:-}
program=${TUBERLINE:-/opt/tuberline/bin/tuberline}
# To look at what would be installed, the program of this clone or of the path will do.
if [ -n "$destdir" ] && [ -z "${TUBERLINE:-}" ] && [ ! -x "$program" ]; then
    program=$here/../.venv/bin/tuberline
    [ -x "$program" ] || program=tuberline
fi
roles=router,aggregator,camera,segmenter,regressor
usual=yes # those, and what else the line's file asks for
certs=
token=
run=
switch_to=
replace=no
start=yes
uninstall=no

fail() {
    echo "install.sh: $1" >&2
    exit 2
}

while [ $# -gt 0 ]; do
    case $1 in
    --roles | --certs | --run | --program | --page-token)
        [ $# -ge 2 ] || fail "$1 needs a value"
        case $1 in
        --program) switch_to=$2 program=$2 ;;
        --roles) roles=$2 usual=no ;;
        --certs) certs=$2 ;;
        --run) run=$2 ;;
        --page-token) token=$2 ;;
        esac
        shift 2
        ;;
    --replace) replace=yes && shift ;;
    --no-start) start=no && shift ;;
    --uninstall) uninstall=yes && shift ;;
    -h | --help) sed -n '2,19s/^# \{0,1\}//p' "$0" && exit 0 ;;
    -*) fail "unknown option $1; see --help" ;;
    *) break ;;
    esac
done

# Takes away what install.sh put into the system, and nothing that a line wrote or that a person wrote for it.
remove_all() {
    if [ -z "$destdir" ]; then
        # Their names are in /etc/tuberline/lines; one that was never installed there has no target to stop.
        for file in /etc/tuberline/lines/*.toml; do
            [ -e "$file" ] || continue
            target=tuberline@$(basename "$file" .toml).target
            systemctl disable --quiet --now "$target" 2>/dev/null || true
        done
        systemctl disable --quiet --now prune-tuberline.timer 2>/dev/null || true
        systemctl stop 'tuberline-*.service' 2>/dev/null || true
    fi
    for there in "$destdir"/etc/systemd/system/tuberline* "$destdir"/etc/systemd/system/prune-tuberline.* \
        "$destdir/etc/systemd/journald@tuberline.conf" "$destdir/etc/sysusers.d/tuberline.conf" \
        "$destdir/etc/tmpfiles.d/tuberline.conf" "$destdir/etc/udev/rules.d/60-tuberline.rules" \
        "$destdir/usr/local/lib/tuberline"; do
        [ -e "$there" ] || continue
        rm -rf "$there"
        echo "removed   ${there#"$destdir"}"
    done
    [ -n "$destdir" ] || systemctl daemon-reload
    for there in /etc/tuberline /var/lib/tuberline /var/log/journal; do
        [ ! -e "$destdir$there" ] || echo "left      $there"
    done
}
if [ "$uninstall" = yes ]; then
    [ $# -eq 0 ] || fail "--uninstall takes no file: it stops every line of this host"
    remove_all
    exit 0
fi
[ $# -eq 1 ] || fail "give one LINE.toml; see --help"
config=$1
case $switch_to in
'' | /*) ;;
*) fail "--program $switch_to: name it from / on, such as /opt/tuberline-0.2/bin/tuberline; units start it from a folder of their own" ;;
esac
command -v "$program" >/dev/null || fail "$program is not there: install Tuberline into /opt/tuberline (docs/deploy.md)"
# As units will read it, from a folder in which nothing else lies.
beside=$(mktemp -d)
nodes=$(mktemp)
trap 'rm -rf "$beside" "$nodes"' EXIT
cp "$config" "$beside/" 2>/dev/null || fail "$config cannot be read"
copy=$beside/$(basename "$config")
checked=$("$program" config show "$copy" --json 2>"$nodes") || {
    sed "s|$copy|$config|g" "$nodes" >&2
    fail "fix $config first"
}

# put SOURCE TARGET MODE: copy where the content differs, and say so. A power cut leaves the old file or the new one:
# without a sync a file system keeps its name and nothing of what is in it.
put() {
    changed=no
    target=$destdir$2
    if [ -f "$target" ] && cmp -s "$1" "$target"; then
        echo "kept      $2"
        return
    fi
    verb=created
    [ ! -e "$target" ] || verb=updated
    install -D -m "$3" "$1" "$target.part"
    sync "$target.part"
    mv -f "$target.part" "$target"
    changed=yes
    echo "$verb   $2"
}

own() {
    [ -n "$destdir" ] || chown "$1" "$2"
}

# Of the config that is on standard input, one line each: the line's name, its cameras, its regressors, its folder of
# certificates, the names of its encoder and of its receiver, what `tuberline run` starts of these two, alarms and viewer.
facts_of() {
    python3 -S -c "
import json, sys
line = json.load(sys.stdin)
print(line['name'], ' '.join(sorted(line['cameras'])), sep='\n')
print(*(f'r{n + 1}' for n in range(line['regressor']['processes'])))
certs = line['link']['certs'] or ''
print(certs if certs.startswith('/') else '/etc/tuberline/certs')
names = {role: line[role]['name'] for role in ('encoder', 'gnss') if line.get(role)}
print(names.get('encoder', ''), names.get('gnss', ''), sep='\n')
live = any(camera['source'] != 'recording' or camera['starts_at_s'] for camera in line['cameras'].values())
others = [role for role in ('alarms', 'viewer') if line.get(role)]
print(*(role for role in (*names, *others) if live or role != 'encoder'))"
}
facts=$(printf '%s\n' "$checked" | facts_of)
line=$(echo "$facts" | sed -n 1p)
installed=$destdir/etc/tuberline/lines/$line.toml
# What runs here is told by the config that it will run with.
keep=no
given=$config
if [ -e "$installed" ] && ! cmp -s "$config" "$installed" && [ "$replace" = no ]; then
    keep=yes
    given="$installed, which is kept without --replace"
    checked=$("$program" config show "$installed" --json) || fail "fix $installed first, or give --replace"
    facts=$(printf '%s\n' "$checked" | facts_of)
fi
cameras=$(echo "$facts" | sed -n 2p)
workers=$(echo "$facts" | sed -n 3p)
certs_there=$(echo "$facts" | sed -n 4p)
encoder=$(echo "$facts" | sed -n 5p)
gnss=$(echo "$facts" | sed -n 6p)
started=$(echo "$facts" | sed -n 7p)
if [ "$usual" = yes ]; then
    for role in $started; do
        roles=$roles,$role
    done
fi
units=
stems=
chosen() { # ROLE NAME: is this one among --roles?
    case ,$roles, in
    *,"$1",* | *,"$1=$2",*) return 0 ;;
    *) return 1 ;;
    esac
}
for role in router aggregator metrics alarms page; do
    if chosen "$role" ""; then
        units="$units tuberline-$role@$line.service"
        case $role in
        metrics | alarms | page) ;; # they only look: they are operators
        *) stems="$stems $role" ;;
        esac
    fi
done
if chosen encoder ""; then
    [ -n "$encoder" ] || fail "role encoder: there is no [encoder] in $given; add it with source = \"serial:/dev/ttyACM0\" or the like and metres_per_pulse"
    units="$units tuberline-encoder@$line.service"
    stems="$stems encoder.$encoder"
fi
if chosen gnss ""; then
    [ -n "$gnss" ] || fail "role gnss: there is no [gnss] in $given; add it with source = \"serial:/dev/ttyACM0\" or the like"
    units="$units tuberline-gnss@$line.service"
    stems="$stems gnss.$gnss"
fi
if chosen alarms ""; then
    case " $started " in
    *" alarms "*) ;;
    *) fail "role alarms: there is no [alarms] in $given; add it with channels = [\"https://...\"] or the like" ;;
    esac
fi
for camera in $cameras; do
    for role in segmenter camera; do
        if chosen "$role" "$camera"; then
            units="$units tuberline-$role@$line:$camera.service"
            stems="$stems $role.$camera"
        fi
    done
done
for worker in $workers; do
    if chosen regressor "$worker"; then
        units="$units tuberline-regressor@$line:$worker.service"
        stems="$stems regressor.$worker"
    fi
done
for entry in $(echo "$roles" | tr ',' ' '); do
    case $entry in
    loader) stems="$stems loader" ;;
    loader=*) stems="$stems loader.${entry#*=}" ;;
    viewer | recorder) units="$units tuberline-$entry@$line:$entry.service" && stems="$stems $entry" ;;
    viewer=* | recorder=* | regressor=*)
        [ "${entry%%=*}" != regressor ] || case " $workers " in *" ${entry#*=} "*) continue ;; esac
        units="$units tuberline-${entry%%=*}@$line:${entry#*=}.service"
        stems="$stems ${entry%%=*}.${entry#*=}"
        ;;
    camera=* | segmenter=*)
        case " $cameras " in
        *" ${entry#*=} "*) ;;
        *) fail "camera '${entry#*=}' is not in $given; known: $cameras" ;;
        esac
        ;;
    router | aggregator | encoder | gnss | metrics | alarms | page | camera | segmenter | regressor) ;;
    *) fail "role '$entry' is not known; known: router aggregator camera segmenter regressor viewer recorder encoder gnss metrics alarms page loader" ;;
    esac
done
case ,$roles in
*,loader*) [ -n "$certs" ] || [ -d "$destdir$certs_there" ] || fail "role loader is a certificate: give --certs DIR. A line without certificates asks for none" ;;
esac
[ -n "$units$stems" ] || fail "--roles $roles leaves nothing to run for line '$line'"

[ "$keep" = yes ] || printf '%s\n' "$checked" | python3 -S "$here/lib/paths.py" "$destdir" "$beside" "$units" || exit 2

files=
if [ -n "$certs" ]; then
    files=ca.pem # the authority's key stays where it was made
    # The page looks as an operator and acts as a loader.
    [ -z "$token" ] || ! chosen page "" || stems="$stems loader"
    for stem in operator $stems; do
        [ -e "$certs/$stem.pem" ] || stem=${stem%%.*} # the certificate its role shares
        for file in "$stem.pem" "$stem.key"; do
            [ -e "$certs/$file" ] || fail "$certs/$file is not there: $program certs make $config --out $certs"
            files="$files $file"
        done
    done
fi
[ -z "$token" ] || { [ -f "$token" ] && [ -r "$token" ]; } || fail "--page-token $token is no file that can be read"

others=
for file in "$destdir"/etc/tuberline/lines/*.toml; do
    [ ! -e "$file" ] || [ "$file" = "$installed" ] || others="$others $(basename "$file" .toml)"
done
# Two lines of one host: what only one of them could have is refused before anything is changed.
if [ -n "$others" ]; then
    {
        printf '%s\n' "$checked"
        for other in $others; do
            "$program" config show "$destdir/etc/tuberline/lines/$other.toml" --json ||
                echo "install.sh: line '$other' is not compared with this one" >&2
        done
    } | python3 -S "$here/lib/clash.py" "$destdir" "$units" "$certs" "$files" || exit 2
fi

put "$here/systemd/sysusers.conf" /etc/sysusers.d/tuberline.conf 644
put "$here/systemd/tmpfiles.conf" /etc/tmpfiles.d/tuberline.conf 644
if [ -z "$destdir" ]; then
    systemd-sysusers tuberline.conf
    systemd-tmpfiles --create tuberline.conf
fi
put "$here/systemd/journald@tuberline.conf" /etc/systemd/journald@tuberline.conf 644
put "$here/udev/60-tuberline.rules" /etc/udev/rules.d/60-tuberline.rules 644
# Cameras that are plugged in already are given to their groups, too; a machine without udev has none.
if [ "$changed" = yes ] && [ -z "$destdir" ] && command -v udevadm >/dev/null; then
    udevadm control --reload && udevadm trigger --subsystem-match=usb --subsystem-match=video4linux || true
fi
[ -e "$destdir/etc/tuberline/environment" ] || put "$here/systemd/environment" /etc/tuberline/environment 644
if [ -z "$destdir" ]; then
    runs=${switch_to:-$(sed -n 's/^TUBERLINE=//p' /etc/tuberline/environment | tail -n 1)}
    runs=${runs:-/opt/tuberline/bin/tuberline}
    case $runs in
    /home/* | /root/* | /run/user/*) fail "$runs: units see no home; install Tuberline into /opt (docs/deploy.md)" ;;
    esac
    runuser -u tuberline -- "$runs" --version >/dev/null ||
        fail "units start $runs, which the user tuberline cannot run: install it for all to read (umask 022), or name another with --program"
fi
for file in node prune; do
    put "$here/lib/$file" "/usr/local/lib/tuberline/$file" 755
done
(cd "$here/systemd" && find . -name '*.service' -o -name '*.timer' -o -name '*.target' -o -path './*.d/*.conf') | sort |
    while read -r file; do
        put "$here/systemd/$file" "/etc/systemd/system/${file#./}" 644
    done

if [ "$keep" = yes ]; then
    put "$config" "/etc/tuberline/lines/$line.toml.new" 640
    echo "kept      /etc/tuberline/lines/$line.toml although $config differs: compare with .new, or give --replace"
else
    put "$config" "/etc/tuberline/lines/$line.toml" 640
    own root:tuberline "$installed"
fi
run_file=$destdir/etc/tuberline/lines/$line.run
if [ -z "$run" ] && [ -s "$run_file" ]; then
    echo "kept      /etc/tuberline/lines/$line.run ($(cat "$run_file"))"
else
    run=${run:-$(date -u +%Y%m%dT%H%M%SZ)}
    echo "$run" >"$run_file.draft"
    put "$run_file.draft" "/etc/tuberline/lines/$line.run" 644
    rm -f "$run_file.draft"
fi

for file in $files; do
    put "$certs/$file" "$certs_there/$file" 600
    own tuberline:tuberline "$destdir$certs_there/$file"
done

if [ -n "$token" ]; then
    put "$token" /etc/tuberline/page-token 600
    own tuberline:tuberline "$destdir/etc/tuberline/page-token"
fi

# An upgrade's one step: a machine that loses its power before it runs the old program again, after it the new one.
if [ -n "$switch_to" ]; then
    [ -n "$destdir" ] || sync # its files are on the disk before they are called
    { grep -v '^TUBERLINE=' "$destdir/etc/tuberline/environment" || true; echo "TUBERLINE=$switch_to"; } >"$nodes"
    put "$nodes" /etc/tuberline/environment 644
    for other in $others; do
        echo "restart   tuberline@$other.target when it suits: until then it goes on with the program before"
    done
fi
{
    echo "# Written by install.sh: what runs here of line $line. Run install.sh again to change it."
    echo "[Unit]"
    for unit in $units; do
        echo "Wants=$unit"
        echo "PropagatesStopTo=$unit"
    done
} >"$nodes"
put "$nodes" "/etc/systemd/system/tuberline@$line.target.d/nodes.conf" 644

if [ -z "$destdir" ]; then
    sync # with the program, which was perhaps installed a moment ago: who sees "started" may switch off
    systemctl daemon-reload
    systemctl enable --quiet "tuberline@$line.target" prune-tuberline.timer
    echo "enabled   tuberline@$line.target prune-tuberline.timer"
    if [ "$start" = yes ]; then
        # Each by its name: a node that is still stopping when its target starts is left running, with the old program.
        [ -z "$switch_to" ] ||
            systemctl stop "tuberline@$line.target" "tuberline-*@$line.service" "tuberline-*@$line:*.service"
        systemctl start "tuberline@$line.target" prune-tuberline.timer
        echo "started   tuberline@$line.target:$units"
    fi
    echo "look      systemctl status 'tuberline-*' · journalctl --namespace=tuberline -f · $program doctor --config /etc/tuberline/lines/$line.toml"
else
    echo "would run:$units"
fi
