# SPDX-License-Identifier: Apache-2.0
#
# What the stand-in of Vivado knows of its objects. An object is a word `type:name`, so that a command
# can refuse one of the wrong type, and a pin is there only if its cell is configured to have it. Messages
# with a number are Vivado's; where users have met them is listed in docs/build-vivado.md.

set vivado [dict create project 0 design "" opened 0 cells {} config {} ports {} interfaces {} nets {} pblocks {} segments {} kind {} filled {} reconfigurable {}]

proc state {key} { return [dict get $::vivado $key] }
proc config {object key default} {
    if {[dict exists $::vivado config $object $key]} { return [dict get $::vivado config $object $key] }
    return $default
}
proc refuse {message} { error $message "" {VIVADO} }
proc is {type object} { return [string match "$type:*" $object] }
proc name_of {object} { return [string range $object [string first : $object]+1 end] }

# The words of a call that are neither switches nor their values, and the switches.
proc split_call {name words} {
    set given [dict create]
    set plain {}
    for {set i 0} {$i < [llength $words]} {incr i} {
        set word [lindex $words $i]
        if {![regexp {^-[a-z]} $word]} { lappend plain $word; continue }
        if {![dict exists $::switches $name $word]} { refuse "$name has no switch $word" }
        if {![dict get $::switches $name $word]} { dict set given $word 1; continue }
        incr i
        if {$i >= [llength $words]} { refuse "$name $word lacks its value" }
        dict set given $word [lindex $words $i]
    }
    return [list $given $plain]
}

# pins of IP: name pattern, and the setting it takes with the value below which it is not there
proc ip_pins {ip} {
    switch -- $ip {
        smartconnect { return {{aclk NUM_CLKS 1} {aclk([0-9]+) NUM_CLKS 0} {aresetn "" 0} {S([0-9][0-9])_AXI NUM_SI 0} {M([0-9][0-9])_AXI NUM_MI 0}} }
        axi_dma { return {{s_axi_lite_aclk "" 0} {axi_resetn "" 0} {S_AXI_LITE "" 0} {m_axi_sg_aclk c_include_sg 1} {M_AXI_SG c_include_sg 1}
            {m_axi_mm2s_aclk c_include_mm2s 1} {M_AXI_MM2S c_include_mm2s 1} {M_AXIS_MM2S c_include_mm2s 1} {mm2s_introut c_include_mm2s 1}
            {m_axi_s2mm_aclk c_include_s2mm 1} {M_AXI_S2MM c_include_s2mm 1} {S_AXIS_S2MM c_include_s2mm 1} {s2mm_introut c_include_s2mm 1}} }
        axi_mcdma { return {{s_axi_lite_aclk "" 0} {axi_resetn "" 0} {S_AXI_LITE "" 0} {s_axi_aclk "" 0} {M_AXI_SG "" 0}
            {M_AXI_MM2S c_include_mm2s 1} {M_AXIS_MM2S c_include_mm2s 1} {mm2s_ch([0-9]+)_introut c_num_mm2s_channels one}
            {M_AXI_S2MM c_include_s2mm 1} {S_AXIS_S2MM c_include_s2mm 1} {s2mm_ch([0-9]+)_introut c_num_s2mm_channels one}} }
        axi_vdma { return {{s_axi_lite_aclk "" 0} {axi_resetn "" 0} {S_AXI_LITE "" 0}
            {m_axi_mm2s_aclk c_include_mm2s 1} {m_axis_mm2s_aclk c_include_mm2s 1} {M_AXI_MM2S c_include_mm2s 1} {M_AXIS_MM2S c_include_mm2s 1} {mm2s_introut c_include_mm2s 1}
            {m_axi_s2mm_aclk c_include_s2mm 1} {s_axis_s2mm_aclk c_include_s2mm 1} {M_AXI_S2MM c_include_s2mm 1} {S_AXIS_S2MM c_include_s2mm 1} {s2mm_introut c_include_s2mm 1}} }
        proc_sys_reset { return {{slowest_sync_clk "" 0} {ext_reset_in "" 0} {peripheral_aresetn "" 0} {interconnect_aresetn "" 0}} }
        xlconcat { return {{dout "" 0} {In([0-9]+) NUM_PORTS 0}} }
        xlconstant { return {{dout "" 0}} }
        processing_system7 { return {{FCLK_RESET0_N "" 0} {M_AXI_GP0 PCW_USE_M_AXI_GP0 1} {M_AXI_GP0_ACLK PCW_USE_M_AXI_GP0 1} {IRQ_F2P PCW_IRQ_F2P_INTR 1}
            {FCLK_CLK([0-9]) PCW_EN_CLK%_PORT 1} {S_AXI_HP([0-9]) PCW_USE_S_AXI_HP% 1} {S_AXI_HP([0-9])_ACLK PCW_USE_S_AXI_HP% 1}} }
        zynq_ultra_ps_e { return {{pl_resetn0 "" 0} {M_AXI_HPM0_FPD PSU__USE__M_AXI_GP0 1} {maxihpm0_fpd_aclk PSU__USE__M_AXI_GP0 1}
            {pl_ps_irq([0-9]) PSU__USE__IRQ% 1} {pl_clk([0-9]) PSU__FPGA_PL%_ENABLE 1} {S_AXI_HP([0-9])_FPD PSU__USE__S_AXI_GP+2 1} {saxihp([0-9])_fpd_aclk PSU__USE__S_AXI_GP+2 1}} }
    }
    return {}
}

# Parameters that a core takes from what it is connected to: BD 41-737 where a script sets one.
proc read_only {ip} {
    switch -- $ip {
        axi_vdma { return {CONFIG.c_s_axis_s2mm_tdata_width CONFIG.c_prmry_is_aclk_async} }
        axi_dma - axi_mcdma { return {CONFIG.c_prmry_is_aclk_async} }
        smartconnect { return {} }
    }
    return {}
}

# Whether a cell has a pin, as it is configured now.
proc has_pin {path} {
    lassign [split [string trimleft $path /] /] cell pin
    if {![dict exists $::vivado cells $cell]} { return 0 }
    foreach entry [ip_pins [dict get $::vivado cells $cell]] {
        lassign $entry pattern setting least
        if {![regexp "^$pattern\$" $pin -> index]} { continue }
        if {$setting eq ""} { return 1 }
        if {$least eq "one"} { return [expr {$index >= 1 && $index <= [config bd_cell:$cell CONFIG.$setting 1]}] }
        if {[regexp {%|\+2} $setting]} {
            set number [expr {[string match *+2 $setting] ? $index + 2 : $index}]
            return [expr {[config bd_cell:$cell CONFIG.[regsub {%|\+2} $setting $number] 0] >= $least}]
        }
        set value [config bd_cell:$cell CONFIG.$setting 1]
        if {$least == 0 && [scan $index %d number] == 1} { return [expr {$number < $value}] }
        return [expr {$value >= $least}]
    }
    return 0
}

# A clock of the processing system in Hz: the dividers of 33.333 MHz seldom meet what is asked for.
proc pin_rate {pin} {
    lassign [split $pin /] cell name
    set megahertz [expr {[string match FCLK* $name]
        ? [config bd_cell:$cell CONFIG.PCW_FPGA[string index $name end]_PERIPHERAL_FREQMHZ 50]
        : [config bd_cell:$cell CONFIG.PSU__CRL_APB__PL[string index $name end]_REF_CTRL__FREQMHZ 100]}]
    set off [expr {[string match FCLK* $name] ? 1.0 : 0.99999001}]
    return [expr {round($megahertz * 1e6 * $off)}]
}
