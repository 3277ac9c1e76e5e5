# SPDX-License-Identifier: Apache-2.0
#
# Commands of the stand-in that look at their objects, `vivado::NAME`; any other known command only
# records its call. Each takes the switches as a dict and the list of the other words.

namespace eval vivado {}

proc typed {name objects args} {
    if {[llength $objects] == 0} { refuse "'$name' expects at least one object" }
    foreach object $objects {
        if {[lsearch -glob [lmap type $args {expr {[is $type $object]}}] 1] < 0} { refuse "'$name': $object is not a [join $args { or }]" }
    }
}

# -- projects and files
proc vivado::create_project {given plain} { dict set ::vivado project 1; return project:current }
proc vivado::close_project {given plain} { dict set ::vivado project 0 }
proc vivado::current_project {given plain} { if {![state project]} { refuse "No open project." }; return project:current }
proc vivado::current_design {given plain} { if {![state opened]} { refuse "No open design." }; return design:current }
proc vivado::get_files {given plain} { return [lmap file $plain {set file file:$file}] }
proc vivado::get_board_parts {given plain} { return [expr {[info exists ::env(CM_NO_BOARD)] ? "" : "board_part:$plain"}] }
proc vivado::get_ips {given plain} { return ip:[expr {[llength $plain] ? [lindex $plain 0] : "all"}] }
proc vivado::create_ip {given plain} {
    foreach folder [vivado::get_property {} [list ip_repo_paths project:current]] {
        if {[file exists $folder/component.xml]} { dict set ::vivado config project:current ip 1 }
    }
    if {![dict exists $::vivado config project:current ip]} { refuse "\[Coretcl 2-1134\] No IP matching VLNV '*:[dict get $given -library]:[dict get $given -name]:*' was found." }
    if {![file isdirectory [dict get $given -dir]]} { refuse "\[Coretcl 2-1126\] the directory '[dict get $given -dir]' does not exist" }
}
proc readable {paths} { foreach path $paths { if {$path eq "" || ![file exists $path]} { refuse "the file '$path' does not exist" } } }
proc vivado::read_verilog {given plain} { readable $plain }
proc vivado::read_vhdl {given plain} { readable $plain }
proc vivado::read_xdc {given plain} { readable $plain }
proc vivado::read_ip {given plain} { readable $plain }
proc vivado::read_bd {given plain} { readable $plain; return file:[lindex $plain 0] }
proc vivado::make_wrapper {given plain} { written work/system/cm_system.gen/sources_1/bd/cm_system/hdl/cm_system_wrapper.v }
proc vivado::generate_target {given plain} {
    typed generate_target [lindex $plain 1] file ip
    if {[is ip [lindex $plain 1]]} { return }
    written work/system/cm_system.gen/sources_1/bd/cm_system/hw_handoff/cm_system.hwh
    written work/system/cm_system.srcs/sources_1/bd/cm_system/cm_system.bd
}
proc written {path} { file mkdir [file dirname $path]; close [open $path w] }

# -- properties
proc vivado::set_property {given plain} {
    if {[dict exists $given -dict]} {
        lassign $plain objects
        set pairs [dict get $given -dict]
    } else {
        lassign $plain key value objects
        set pairs [list $key $value]
    }
    if {[llength $objects] == 0} { refuse "\[Common 17-55\] 'set_property' expects at least one object." }
    foreach object $objects {
        if {![regexp {^\w+:} $object]} { refuse "'set_property': '$object' is no object" }
        foreach {key value} $pairs {
            if {[is bd_cell $object] && $key in [read_only [dict get $::vivado cells [name_of $object]]]} {
                refuse "\[BD 41-737\] Cannot set the parameter [string range $key 7 end] on /[name_of $object]. It is read-only."
            }
            in_range $object $key $value
            if {$key eq "HD.RECONFIGURABLE" && [is cell $object]} { dict lappend ::vivado reconfigurable [name_of $object] }
            dict set ::vivado config $object $key $value
        }
    }
}
# Ranges of parameters, from their product guides (PG021, PG247, PG082, PG201): what is outside is no customisation.
proc in_range {object key value} {
    if {![is bd_cell $object]} { return }
    set ip [dict get $::vivado cells [name_of $object]]
    foreach {which parameter low high} {
        axi_dma CONFIG.c_sg_length_width 8 26
        smartconnect CONFIG.NUM_SI 1 16
        smartconnect CONFIG.NUM_MI 1 16
        processing_system7 CONFIG.PCW_FPGA0_PERIPHERAL_FREQMHZ 0.1 250
    } {
        if {$ip eq $which && $key eq $parameter && !($value >= $low && $value <= $high)} {
            refuse "\[IP_Flow 19-3461\] Value '$value' is out of the range for parameter '[string range $key 7 end]' for BD Cell '[name_of $object]' . Valid values are - $low to $high"
        }
    }
}
proc vivado::get_property {given plain} {
    lassign $plain key objects
    typed get_property $objects *
    if {$key eq "CONFIG.FREQ_HZ" && [is bd_pin $objects]} { return [pin_rate [name_of $objects]] }
    if {$key eq "SLACK"} { return [expr {[info exists ::env(CM_SLACK)] && [is "timing_path" $objects] && [string match "*[expr {[info exists ::env(CM_KIND)] ? $::env(CM_KIND) : {setup}}]" $objects] ? $::env(CM_SLACK) : 0.123}] }
    return [config $objects $key ""]
}

# -- block design
proc vivado::create_bd_design {given plain} { dict set ::vivado design [lindex $plain 0] }
proc vivado::get_ipdefs {given plain} {
    regexp {ip:(\w+):} [dict get $given -filter] -> ip
    return [list xilinx.com:ip:$ip:1.9 xilinx.com:ip:$ip:1.10]
}
proc vivado::create_bd_cell {given plain} {
    set name [lindex $plain 0]
    if {[dict exists $::vivado cells $name]} { refuse "cell '$name' is already in the design" }
    dict set ::vivado cells $name [lindex [split [dict get $given -vlnv] :] 2]
    return bd_cell:$name
}
proc vivado::apply_bd_automation {given plain} { typed apply_bd_automation [lindex $plain 0] bd_cell }
proc vivado::create_bd_port {given plain} { return [new_port bd_port ports $given $plain] }
proc vivado::create_bd_intf_port {given plain} { return [new_port bd_intf_port interfaces $given $plain] }
proc new_port {type kind given plain} {
    set name [lindex $plain 0]
    if {[dict exists $::vivado ports $name] || [dict exists $::vivado interfaces $name]} { refuse "port '$name' exists already" }
    dict set ::vivado $kind $name $given
    return $type:$name
}
proc found_pins {type plain} {
    set found {}
    foreach path $plain { if {[has_pin $path]} { lappend found $type:[string trimleft $path /] } else { puts stderr "WARNING: \[[expr {$type eq {bd_pin} ? {BD 5-235} : {BD 5-232}}]\] No [expr {$type eq {bd_pin} ? {} : {interface }}]pins matched '$path'" } }
    return $found
}
proc vivado::get_bd_pins {given plain} { return [found_pins bd_pin $plain] }
proc vivado::get_bd_intf_pins {given plain} { return [found_pins bd_intf_pin $plain] }
proc vivado::get_bd_ports {given plain} { return [lmap name $plain {if {![dict exists $::vivado ports $name]} continue; set name bd_port:$name}] }
proc vivado::get_bd_intf_ports {given plain} { return [lmap name $plain {if {![dict exists $::vivado interfaces $name]} continue; set name bd_intf_port:$name}] }
proc vivado::connect_bd_net {given plain} {
    if {[lsearch -exact $plain {}] >= 0 || [llength $plain] < 2} { refuse "\[BD 41-701\] connect_bd_net requires at least two pins/ports, or one pin/port and a net" }
    foreach end $plain { typed connect_bd_net $end bd_pin bd_port }
    lassign $plain source target
    if {[dict exists $::vivado nets $target]} { refuse "'$target' is driven by '[dict get $::vivado nets $target]' already" }
    if {[regexp {_introut$|aresetn$|/dout$|/FCLK_|/pl_clk|/pl_resetn} $target] && ![is bd_port $target] && ![regexp {axi_resetn$|/aresetn$} $target]} { refuse "'$target' is an output: '$source' cannot drive it" }
    dict set ::vivado nets $target $source
}
proc vivado::connect_bd_intf_net {given plain} {
    foreach end $plain {
        if {[llength $end] == 0} { refuse "connect_bd_intf_net: no such interface pin" }
        typed connect_bd_intf_net $end bd_intf_pin bd_intf_port
        if {[dict exists $::vivado nets $end]} { refuse "'$end' is connected already" }
        dict set ::vivado nets $end 1
    }
}
proc vivado::get_bd_addr_spaces {given plain} { return bd_addr_space:[lindex $plain 0] }
proc vivado::get_bd_addr_segs {given plain} { return bd_addr_seg:[lindex $plain 0] }
proc vivado::assign_bd_address {given plain} {
    if {![dict exists $given -offset]} { return }
    typed assign_bd_address [lindex $plain 0] bd_addr_seg
    set from [expr {[dict get $given -offset]}]
    set size [expr {[dict get $given -range]}]
    if {$size & ($size - 1) || $from % $size} { refuse "\[BD 41-1075\] Cannot create master segment for slave segment <[lindex $plain 0]> at offset and range [dict get $given -offset] [dict get $given -range]: no aligned power of two" }
    foreach other [state segments] {
        lassign $other base bytes who
        if {$from < $base + $bytes && $base < $from + $size} { refuse "\[BD 41-971\] Segment [lindex $plain 0] overlaps $who" }
    }
    dict lappend ::vivado segments [list $from $size [lindex $plain 0]]
}

# What validate_bd_design stops at.
proc vivado::validate_bd_design {given plain} {
    dict for {cell ip} [state cells] {
        foreach entry [ip_pins $ip] {
            set pin [lindex $entry 0]
            if {[regexp {^(s_axi_lite_aclk|s_axi_aclk|[ms]_axis_\w+_aclk|m_axi_\w+_aclk|slowest_sync_clk|aclk|maxi\w+|M_AXI_GP0_ACLK)$} $pin] && [has_pin $cell/$pin] && ![dict exists $::vivado nets bd_pin:$cell/$pin]} {
                refuse "\[BD 41-758\] The following clock pins are not connected to a valid clock source: /$cell/$pin"
            }
        }
    }
    dict for {name given} [state interfaces] {
        if {![dict exists $::vivado nets bd_intf_port:$name]} { refuse "interface port '$name' is not connected" }
        set clock ""
        dict for {port _} [state ports] { if {$name in [split [config bd_port:$port CONFIG.ASSOCIATED_BUSIF ""] :]} { set clock $port } }
        if {$clock eq ""} { refuse "\[BD 41-967\] AXI interface port /$name is not associated to any clock port. It may not work correctly." }
        set real [pin_rate [name_of [dict get $::vivado nets bd_port:$clock]]]
        set said [config bd_intf_port:$name CONFIG.FREQ_HZ 100000000]
        if {$said != $real} { refuse "\[BD 41-237\] Bus Interface property FREQ_HZ does not match between /$name ($said) and its clock ($real)" }
    }
}

# -- netlist
# A checkpoint says what it is: `full` (a whole design), `module` (out of context) or `shell CELL`, then the cells that
# hold a module. What is compared or written has to be of the right kind (UG909).
proc vivado::synth_design {given plain} { design [expr {[dict exists $given -mode] ? "module" : "full"}] {} }
proc design {kind filled} { dict set ::vivado opened 1; dict set ::vivado kind $kind; dict set ::vivado filled $filled }
proc checkpoint {path} {
    set file [open $path]
    set said [string trim [read $file]]
    close $file
    if {[llength $said] != 2} { refuse "$path is no checkpoint" }
    return $said
}
proc vivado::open_checkpoint {given plain} { readable $plain; design {*}[checkpoint [lindex $plain 0]] }
proc vivado::read_checkpoint {given plain} {
    readable $plain
    opened read_checkpoint
    set cell [dict get $given -cell]
    if {[lindex [checkpoint [lindex $plain 0]] 0] ne "module"} { refuse "[lindex $plain 0] is not a module synthesised out of context" }
    in_reach read_checkpoint $cell
    dict lappend ::vivado filled $cell
}
# In an abstract shell there is one cell to work on.
proc in_reach {name cell} {
    set kind [state kind]
    if {[lindex $kind 0] eq "shell" && [lindex $kind 1] ne $cell} { refuse "'$name': $cell is not in the abstract shell of [lindex $kind 1]" }
}
proc vivado::update_design {given plain} {
    opened update_design
    set cell [dict get $given -cells]
    in_reach update_design $cell
    set filled [lsearch -all -inline -not -exact [state filled] $cell]
    dict set ::vivado filled [expr {[dict exists $given -black_box] ? $filled : [list {*}$filled $cell]}]
}
proc vivado::write_checkpoint {given plain} { opened write_checkpoint; written [lindex $plain 0]; keep [lindex $plain 0] [state kind] [state filled] }
proc keep {path kind filled} {
    set file [open $path w]
    puts $file [list $kind $filled]
    close $file
}
proc vivado::write_abstract_shell {given plain} {
    opened write_abstract_shell
    set cell [dict get $given -cell]
    if {[state kind] ne "full"} { refuse "write_abstract_shell needs a fully implemented design" }
    if {$cell ni [state filled]} { refuse "write_abstract_shell: $cell holds no reconfigurable module" }
    keep [lindex $plain 0] [list shell $cell] {}
    # what is in memory is the shell from now on: nothing may count on more
    design [list shell $cell] {}
}
proc opened {name} { if {![state opened]} { refuse "No open design. Please open one before $name." } }
proc vivado::get_cells {given plain} { return cell:[lindex $plain 0] }
proc vivado::get_pins {given plain} { return pin:all }
proc vivado::get_ports {given plain} { return port:[lindex $plain 0] }
proc vivado::create_pblock {given plain} {
    opened create_pblock
    set name [lindex $plain 0]
    if {$name in [state pblocks]} { refuse "a pblock '$name' exists already" }
    dict lappend ::vivado pblocks $name
    return pblock:$name
}
proc vivado::get_pblocks {given plain} { return [lmap name $plain {if {$name ni [state pblocks]} continue; set name pblock:$name}] }
proc vivado::resize_pblock {given plain} { typed resize_pblock [lindex $plain 0] pblock }
proc vivado::add_cells_to_pblock {given plain} { typed add_cells_to_pblock [lindex $plain 0] pblock; typed add_cells_to_pblock [lindex $plain 1] cell }
proc vivado::opt_design {given plain} {
    opened opt_design
    foreach cell [state reconfigurable] {
        if {$cell ni [state filled]} { refuse "\[DRC INBB-3\] Black Box Instances: Cell '$cell' has undefined contents and is considered a black box. The contents of this cell must be defined for opt_design to complete successfully." }
    }
}
proc vivado::lock_design {given plain} { opened lock_design }
proc vivado::pr_verify {given plain} {
    readable [list [dict get $given -initial] {*}[dict get $given -additional]]
    lassign [checkpoint [dict get $given -initial]] kind
    foreach path [dict get $given -additional] {
        lassign [checkpoint $path] other filled
        if {$other ne $kind} { refuse "pr_verify: [dict get $given -initial] ($kind) and $path ($other) are not of one kind" }
        if {![llength $filled]} { refuse "pr_verify: $path holds no module" }
    }
}
proc vivado::write_bitstream {given plain} {
    opened write_bitstream
    if {[state kind] eq "module"} { refuse "write_bitstream: a module by itself has no static design around it" }
    if {[dict exists $given -cell]} {
        if {[dict get $given -cell] ni [state filled]} { refuse "write_bitstream: [dict get $given -cell] holds no module" }
    } elseif {[state kind] ne "full"} {
        refuse "write_bitstream: an abstract shell gives partial bitstreams only, -cell is needed"
    }
    written [lindex $plain 0]
}
proc vivado::write_cfgmem {given plain} { readable [list [lindex [dict get $given -loadbit] 2]]; written [lindex $plain 0] }
proc vivado::write_hw_platform {given plain} {
    if {[info exists ::env(CM_NO_XSA)]} { refuse "Command failed: write_hw_platform" }
    written [dict get $given -file]
}
proc vivado::get_timing_paths {given plain} { return timing_path:[expr {[dict exists $given -hold] ? "hold" : "setup"}] }
proc vivado::report_timing_summary {given plain} {
    if {![dict exists $given -return_string]} { return }
    return [expr {[info exists ::env(CM_PULSE_WIDTH)] ? "Timing constraints are not met." : "All user specified timing constraints are met."}]
}
proc vivado::get_drc_violations {given plain} { return [expr {[info exists ::env(CM_DRC)] ? $::env(CM_DRC) : ""}] }

# -- what scripts ask for
proc vivado::version {given plain} { return [expr {[info exists ::env(CM_VERSION)] ? $::env(CM_VERSION) : "2023.2"}] }
proc vivado::get_clock_regions {given plain} {
    if {[dict exists $given -of_objects]} { return X0Y0 }
    return [expr {[llength $plain] ? $plain : {X0Y0 X1Y0 X0Y1 X1Y1 X0Y2 X1Y2}}]
}
# every clock region has 1200 slices, 20 block RAMs and 20 DSPs, in columns of its own
proc vivado::get_sites {given plain} {
    if {![regexp {X(\d+)Y(\d+)} [dict get $given -of_objects] -> x y]} { return }
    regexp {=~ "?(\w+)} [dict get $given -filter] -> kind
    set kind [dict get {SLICE SLICE RAMB RAMB36 RAMB36 RAMB36 RAMB36_X RAMB36 RAMB18_X RAMB18 SLICE_X SLICE DSP48 DSP48E2 DSP48_X DSP48 DSP48E2_X DSP48E2 URAM288_X none} $kind]
    if {$kind eq "none"} { return }
    lassign [expr {$kind eq "SLICE" ? {20 60} : {1 20}}] wide high
    set found {}
    for {set i 0} {$i < $wide} {incr i} { for {set j 0} {$j < $high} {incr j} { lappend found site:${kind}_X[expr {$x * $wide + $i}]Y[expr {$y * $high + $j}] } }
    return $found
}
proc vivado::get_msg_config {given plain} { return [expr {[info exists ::env(CM_PR_VERIFY)] ? $::env(CM_PR_VERIFY) : 1}] }
