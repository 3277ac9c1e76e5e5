-- SPDX-License-Identifier: Apache-2.0
-- Darker by half, or by what SHIFT says; inverted where INVERT does. A register between its sides, and none of AXI4-Lite.
library ieee;
use ieee.std_logic_1164.all;
library helpers;
use helpers.arith.all;

entity Dim is
    generic (
        SHIFT  : natural;
        INVERT : boolean := false
    );
    port (
        Clk           : in  std_logic;
        ResetN        : in  std_logic;
        S_AXIS_TDATA  : in  std_logic_vector(7 downto 0);
        S_AXIS_TVALID : in  std_logic;
        S_AXIS_TREADY : out std_logic;
        S_AXIS_TLAST  : in  std_logic;
        M_AXIS_TDATA  : out std_logic_vector(7 downto 0);
        M_AXIS_TVALID : out std_logic;
        M_AXIS_TREADY : in  std_logic;
        M_AXIS_TLAST  : out std_logic
    );
end entity;

architecture rtl of Dim is
    signal ready, valid : std_logic;
begin
    ready         <= M_AXIS_TREADY or not valid;
    S_AXIS_TREADY <= ready;
    M_AXIS_TVALID <= valid;

    process (Clk)
    begin
        if rising_edge(Clk) then
            if ResetN = '0' then
                valid <= '0';
            elsif ready = '1' then
                valid        <= S_AXIS_TVALID;
                M_AXIS_TLAST <= S_AXIS_TLAST;
                if INVERT then
                    M_AXIS_TDATA <= not weaken(S_AXIS_TDATA, SHIFT);
                else
                    M_AXIS_TDATA <= weaken(S_AXIS_TDATA, SHIFT);
                end if;
            end if;
        end if;
    end process;
end architecture;
