-- SPDX-License-Identifier: Apache-2.0
library ieee;
use ieee.std_logic_1164.all;

package filter_types is
  constant LANES : natural := 2;
  constant WORD  : natural := 16 * LANES; -- "end package" in a comment
  subtype word_t is std_logic_vector(WORD - 1 downto 0);
  type record_t is record
    valid : std_logic;
  end record;
end package filter_types;

library ieee;
use ieee.std_logic_1164.all;
use work.filter_types.all;

entity Filter is
  generic (
    C_ADDR_BITS : integer := 2 ** 3 - 1;
    C_BASE      : std_logic_vector(31 downto 0) := X"4000_0000";
    C_DEPTH     : integer := 64
  );
  port (
    S_AXIS_ACLK, S_AXIS_ARESETN : in std_logic;
    -- s_axis_old : in std_logic;
    s_axis_tdata  : in  word_t;
    s_axis_tvalid : in  std_logic;
    s_axis_tready : out std_logic;
    m_axis_tdata  : out std_logic_vector(WORD - 1 downto 0) := (others => '0');
    m_axis_tvalid : out std_logic;
    m_axis_tready : in  std_logic;
    level         : out std_logic_vector(integer(ceil(log2(real(C_DEPTH)))) downto 0);
    address       : in  std_logic_vector(0 to C_ADDR_BITS);
    debug         : out record_t;
    count         : out integer range 0 to 7;
    done          : buffer std_logic
  );
end entity Filter;

architecture rtl of Filter is
  attribute X_INTERFACE_INFO : string;
  attribute X_INTERFACE_PARAMETER : string;
  attribute X_INTERFACE_INFO of done : signal is "xilinx.com:signal:interrupt:1.0 " & "done INTERRUPT";
  attribute X_INTERFACE_PARAMETER of S_AXIS_ACLK : signal is "ASSOCIATED_BUSIF S_AXIS:M_AXIS, ASSOCIATED_RESET S_AXIS_ARESETN";
begin
  kernel : entity work.filter_kernel port map (clk => S_AXIS_ACLK);
end architecture rtl;

library ieee;
use ieee.std_logic_1164.all;

entity filter_kernel is
  port (clk : in std_logic);
end entity;
