# SPDX-License-Identifier: Apache-2.0
#
# Runs a generated script without Vivado: tclsh replay.tcl KNOWN RECORD SCRIPT
# KNOWN has one line per command of Vivado that may be called: its name, then how each switch takes
# a value (-switch=1) or not (-switch=0). Every call is written to RECORD as a Tcl list. A command
# or switch that is not known, or a value that is missing, is an error.

lassign $argv known_file record_file script
set known [dict create]
set file [open $known_file]
while {[gets $file line] >= 0} {
    dict set known [lindex $line 0] [lrange $line 1 end]
}
close $file
set record [open $record_file w]

proc unknown {name args} {
    global known record
    if {![dict exists $known $name]} {
        error "unknown command: $name $args"
    }
    puts $record [list $name {*}$args]
    set switches [dict create]
    foreach entry [dict get $known $name] {
        lassign [split $entry =] switch takes
        dict set switches $switch $takes
    }
    for {set i 0} {$i < [llength $args]} {incr i} {
        set word [lindex $args $i]
        if {![regexp {^-[a-z]} $word]} {
            continue
        }
        if {![dict exists $switches $word]} {
            error "$name has no switch $word"
        }
        if {[dict get $switches $word]} {
            incr i
            if {$i >= [llength $args]} {
                error "$name $word lacks its value"
            }
        }
    }
    return [answer $name {*}$args]
}

# What the scripts look at.
proc answer {name args} {
    switch -- $name {
        version { return 2023.2 }
        get_ipdefs {
            regexp {ip:(\w+):} $args -> ip
            return [list xilinx.com:ip:$ip:1.9 xilinx.com:ip:$ip:1.10]
        }
        create_bd_cell { return /[lindex $args end] }
        get_clock_regions {
            if {[llength $args] == 1} { return $args }
            if {[llength $args] > 1} { return X0Y0 }
            return {X0Y0 X1Y0 X0Y1 X1Y1 X0Y2 X1Y2}
        }
        get_sites {
            if {[string match *SLICE* $args]} { return [lrepeat 1200 s] }
            return [lrepeat 20 r]
        }
        get_msg_config { return [expr {[info exists ::env(CM_PR_VERIFY)] ? $::env(CM_PR_VERIFY) : 1}] }
        get_property { return [expr {[info exists ::env(CM_SLACK)] ? $::env(CM_SLACK) : 0.123}] }
        default { return [list ${name}_result] }
    }
}

set status [catch {source $script} message]
close $record
if {$status} {
    puts stderr $message
    exit 1
}
