// Transfer, mill: faces a part and hands it to the loader (start program 20 in coordinate system 2, too)
N10 G17 G64 G90 G54
N20 M10 VA1 VB30
N30 M98 P1001
N40 M100 VA1
N50 M03 S5000
N60 G00 X-15 Y10
N70 G00 Z2
N80 G01 Z-0.5 F500
N90 X130 F3600
N100 Y30
N110 X-10
N120 Y50
N130 X130
N140 Y70
N150 X-15
N160 G00 Z100
N170 M05
N180 G00 X-50 Y240          // out of the loader's way
N190 M70                    // meets the loader: it holds the part when this is reset
N200 M11 VA1
N210 M70                    // meets the loader again: the part is out
N220 G00 X-50 Y-40
N230 M30
