/PROG  CALIB
/ATTR
LINE_COUNT	= 16;
DEFAULT_GROUP	= 1,*,*,*,*;
/MN
   1:J P[1] 20% FINE    ;
   2:J P[2] 20% FINE    ;
   3:J P[3] 20% FINE    ;
   4:J P[4] 20% FINE    ;
   5:J P[5] 20% FINE    ;
   6:J P[6] 20% FINE    ;
   7:J P[7] 20% FINE    ;
   8:J P[8] 20% FINE    ;
   9:J P[9] 20% FINE    ;
  10:J P[10] 20% FINE    ;
  11:J P[11] 20% FINE    ;
  12:J P[12] 20% FINE    ;
  13:J P[13] 20% FINE    ;
  14:J P[14] 20% FINE    ;
  15:J P[15] 20% FINE    ;
  16:J P[16] 20% FINE    ;
/POS
P[1]{
   GP1:
	UF : 0, UT : 1,	
	J1= -101.8360 deg,	J2=  -56.8250 deg,	J3=  -34.5120 deg,
	J4=  102.3680 deg,	J5=  -87.3338 deg,	J6=  -57.8005 deg
};
P[2]{
   GP1:
	UF : 0, UT : 1,	
	J1=   65.4764 deg,	J2=  -82.9688 deg,	J3=   -9.8207 deg,
	J4=   -3.4501 deg,	J5=   45.9776 deg,	J6=  114.3944 deg
};
P[3]{
   GP1:
	UF : 0, UT : 1,	
	J1=   -9.4565 deg,	J2=  -65.7699 deg,	J3=  -54.6854 deg,
	J4=  -45.1253 deg,	J5=  -38.2082 deg,	J6=   50.9815 deg
};
P[4]{
   GP1:
	UF : 0, UT : 1,	
	J1=  112.5245 deg,	J2= -108.5386 deg,	J3=   21.1182 deg,
	J4=   35.6341 deg,	J5=  -74.0819 deg,	J6=  110.1907 deg
};
P[5]{
   GP1:
	UF : 0, UT : 1,	
	J1=   -1.8365 deg,	J2= -116.0821 deg,	J3=  -44.5882 deg,
	J4= -112.0047 deg,	J5=    4.4560 deg,	J6= -110.2713 deg
};
P[6]{
   GP1:
	UF : 0, UT : 1,	
	J1=   97.0711 deg,	J2=  -51.9129 deg,	J3=  -21.9347 deg,
	J4=  102.6333 deg,	J5=  -18.1825 deg,	J6= -126.4659 deg
};
P[7]{
   GP1:
	UF : 0, UT : 1,	
	J1=   15.1691 deg,	J2=  -30.1806 deg,	J3=   45.7349 deg,
	J4=   47.6208 deg,	J5=   44.3297 deg,	J6=  -52.5643 deg
};
P[8]{
   GP1:
	UF : 0, UT : 1,	
	J1=  -80.4621 deg,	J2=  -71.0848 deg,	J3=   12.2367 deg,
	J4=    6.7446 deg,	J5=   23.2515 deg,	J6=  178.1696 deg
};
P[9]{
   GP1:
	UF : 0, UT : 1,	
	J1=  -30.1164 deg,	J2=  -26.0193 deg,	J3=   -4.0005 deg,
	J4= -113.9161 deg,	J5=   -8.6179 deg,	J6=  141.4182 deg
};
P[10]{
   GP1:
	UF : 0, UT : 1,	
	J1=   -5.0469 deg,	J2=  -24.5842 deg,	J3=   -9.6318 deg,
	J4=  -13.2941 deg,	J5=   21.7474 deg,	J6=  -46.3756 deg
};
P[11]{
   GP1:
	UF : 0, UT : 1,	
	J1= -111.1187 deg,	J2= -106.2496 deg,	J3=   61.9156 deg,
	J4=  -67.9856 deg,	J5=   69.5865 deg,	J6=   89.3687 deg
};
P[12]{
   GP1:
	UF : 0, UT : 1,	
	J1=  -77.6815 deg,	J2=  -23.8510 deg,	J3=  -22.2785 deg,
	J4=  -28.2076 deg,	J5=  -32.4309 deg,	J6=  104.0914 deg
};
P[13]{
   GP1:
	UF : 0, UT : 1,	
	J1=  -72.5261 deg,	J2=  -69.8002 deg,	J3=  -30.2747 deg,
	J4= -107.4987 deg,	J5=   33.8812 deg,	J6=  -31.8872 deg
};
P[14]{
   GP1:
	UF : 0, UT : 1,	
	J1=   72.0144 deg,	J2=  -46.4270 deg,	J3=  -24.2964 deg,
	J4=   19.3825 deg,	J5=   10.9410 deg,	J6=  120.6706 deg
};
P[15]{
   GP1:
	UF : 0, UT : 1,	
	J1=  -93.4578 deg,	J2=  -66.3293 deg,	J3=  -53.8847 deg,
	J4=  -62.3531 deg,	J5=  -20.4505 deg,	J6=  -81.2851 deg
};
P[16]{
   GP1:
	UF : 0, UT : 1,	
	J1=  -93.6400 deg,	J2= -119.7085 deg,	J3=  -23.1845 deg,
	J4=  -75.6103 deg,	J5=    2.9736 deg,	J6=   64.7854 deg
};
/END
