-- SPDX-License-Identifier: Apache-2.0
-- A package in a library of its own.
library ieee;
use ieee.std_logic_1164.all;
use ieee.numeric_std.all;

package arith is
    function weaken(value : std_logic_vector; bits : natural) return std_logic_vector;
end package;

package body arith is
    function weaken(value : std_logic_vector; bits : natural) return std_logic_vector is
    begin
        return std_logic_vector(shift_right(unsigned(value), bits));
    end function;
end package body;
