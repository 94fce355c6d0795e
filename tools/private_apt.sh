# SPDX-License-Identifier: Apache-2.0
# Sourced: apt-get with the machine's package sources and keys, but with lists and archives of its own in a folder. It
# takes neither root nor a change to the machine.

# private_apt FOLDER TYPE [OPTION...]: fetch the lists and set the array apt. TYPE: deb or deb-src.
private_apt() {
    local dir=$1 type=$2 file
    shift 2
    mkdir -p "$dir"/{parts,lists/partial,cache/archives/partial}
    for file in /etc/apt/sources.list /etc/apt/sources.list.d/*.{list,sources}; do
        [ -r "$file" ] || continue
        sed -E "s/^deb /$type /; s/^Types:.*/Types: $type/" "$file" \
            >"$dir/parts/$(basename "$file" | sed 's/^sources.list$/&.list/')"
    done
    apt=(apt-get -q -o Dir::Etc::SourceList=/dev/null -o "Dir::Etc::SourceParts=$dir/parts"
        -o "Dir::State::Lists=$dir/lists" -o "Dir::Cache=$dir/cache" -o APT::Sandbox::User=root "$@")
    "${apt[@]}" update >"$dir/log" 2>&1 || true # a foreign repository without these packages is no harm
}
