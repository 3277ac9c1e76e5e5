# SPDX-License-Identifier: Apache-2.0
#
# Runs a generated script without Vivado: tclsh replay.tcl KNOWN RECORD SCRIPT
# KNOWN has one line per command of Vivado that may be called: its name, then how each switch takes
# a value (-switch=1) or not (-switch=0). Every call is written to RECORD as a Tcl list. A command
# or switch that is not known, or a value that is missing, is an error; so is an object of the wrong
# type, or one that is not there (stand_in.tcl, objects.tcl).

lassign $argv known_file record_file script
set switches [dict create]
set file [open $known_file]
while {[gets $file line] >= 0} {
    set entries [dict create]
    foreach entry [lrange $line 1 end] { dict set entries {*}[split $entry =] }
    dict set switches [lindex $line 0] $entries
}
close $file
set record [open $record_file w]
source [file dirname [info script]]/objects.tcl
source [file dirname [info script]]/stand_in.tcl

proc unknown {name args} {
    if {![dict exists $::switches $name]} { error "unknown command: $name $args" }
    puts $::record [list $name {*}$args]
    lassign [split_call $name $args] given plain
    if {[llength [info procs ::vivado::$name]] == 0} { return ${name}_result }
    return [vivado::$name $given $plain]
}

set status [catch {source $script} message]
close $record
if {$status} {
    puts stderr $message
    exit 1
}
